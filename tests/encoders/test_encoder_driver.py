"""The driver on the emulated node: truth recovered, faults reported as what they are."""

import itertools

import can
import numpy as np
import pytest

from hil.config.encoders import EncodersConfig
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import Status
from hil.drivers.encoders.as5045.driver import As5045Encoders
from hil.fakes.encoders.as5045.encoder import EncoderTruthOptions

IDEAL = EncoderTruthOptions(noise_rad=0.0, once_rad=0.0, twice_rad=0.0)
OK4 = (Status.OK,) * 4


def test_angles_are_the_true_steering_at_the_time_of_the_stamp(encoder_bench, steering_plant, drain):
    bench = encoder_bench(plant=steering_plant((0.1, -0.4, 1.5, -1.2), rate_rad_s=0.5), options=IDEAL)
    bench.driver.open()
    samples = [s for s in drain(bench, 300) if s.status == OK4]
    assert len(samples) > 580
    for sample in samples:
        truth = bench.plant.start_rad + 0.5 * sample.stamp.t_ns * 1e-9
        np.testing.assert_allclose(sample.angle_rad, truth, atol=0.0015)
        assert sample.stamp.t_ns <= sample.stamp.host_ns
    assert [s.stamp.seq for s in samples] == list(range(samples[0].stamp.seq, samples[-1].stamp.seq + 1))


def test_start_up_garbage_never_passes_as_an_angle(encoder_bench, drain):
    bench = encoder_bench(options=IDEAL)
    bench.driver.open()
    statuses = {s for sample in drain(bench, 2) for s in sample.status}
    assert statuses == {Status.STARTING}
    assert drain(bench, 10)[-1].status == OK4


def test_node_time_and_sequence_survive_their_wraps(encoder_bench, drain):
    bench = encoder_bench()
    bench.driver.open()
    samples = drain(bench, 2300)
    device = [s.stamp.device_ns for s in samples]
    assert samples[-1].stamp.seq > 4000
    assert device[-1] > 22_000_000_000
    assert np.all(np.diff(device) > 0)


def test_a_long_silence_does_not_lose_the_time_axis(encoder_bench, drain):
    bench = encoder_bench("encoders:intermittent@1+12,period_s=12,duty=1", config={"fail_after_s": 60})
    bench.driver.open()
    last = drain(bench, 1400)[-1]
    assert last.status == OK4
    assert last.stamp.device_ns == pytest.approx(last.stamp.t_ns, abs=5_000_000)


@pytest.mark.parametrize(
    ("fault", "status"),
    [
        ("encoder.BL:off", Status.STARTING),
        ("encoder.BL:garbage,flags=6", Status.MAGNET),
        ("encoder.BL:garbage,flags=16", Status.HARDWARE_ERROR),
        ("encoder.BL:corrupt,probability=1", Status.PARITY),
    ],
)
def test_one_bad_axis_leaves_the_others_usable(encoder_bench, drain, fault, status):
    bench = encoder_bench(fault)
    bench.driver.open()
    for sample in drain(bench, 20)[6:]:
        assert sample.status == (Status.OK, status, Status.OK, Status.OK)
        assert np.isnan(sample.angle_rad[1])
        assert np.all(np.isfinite(sample.angle_rad[[0, 2, 3]]))


def test_garbage_words_are_mostly_caught_and_never_raise(encoder_bench, drain):
    bench = encoder_bench("encoders:garbage")
    bench.driver.open()
    statuses = [s for sample in drain(bench, 100) for s in sample.status]
    assert statuses.count(Status.PARITY) > 300
    assert statuses.count(Status.OK) < 0.2 * len(statuses)


def test_stuck_words_and_wrong_angles_look_plausible(encoder_bench, steering_plant, drain):
    bench = encoder_bench(
        "encoder.FL:stuck@0.5",
        "encoder.FR:wrong@0.5,offset_rad=0.3",
        plant=steering_plant(rate_rad_s=0.2),
        options=IDEAL,
    )
    bench.driver.open()
    last = drain(bench, 150)[-1]
    truth = 0.2 * last.stamp.t_ns * 1e-9
    assert last.status == OK4
    assert last.angle_rad[0] == pytest.approx(0.1, abs=0.01)
    np.testing.assert_allclose(last.angle_rad[1:], [truth, truth, truth + 0.3], atol=0.002)


def test_slow_and_delayed(encoder_bench, drain):
    bench = encoder_bench("encoders:slow@1,factor=4")
    bench.driver.open()
    drain(bench, 100)
    assert len(drain(bench, 100)) == pytest.approx(50, abs=2)
    late = encoder_bench("encoders:delayed@0.1,delay_s=0.05", seed=2)
    late.driver.open()
    sample = drain(late, 50)[-1]
    assert sample.stamp.host_ns - sample.stamp.device_ns > 50_000_000


@pytest.mark.parametrize("fault", ["encoders:reset@1", "encoders:brownout@1+0.3", "encoders:off@1+0.3"])
def test_a_node_restart_is_followed(encoder_bench, drain, fault):
    bench = encoder_bench(fault, options=IDEAL)
    bench.driver.open()
    samples = drain(bench, 200)
    assert samples[-1].status == OK4
    assert samples[-1].stamp.device_ns < 1_000_000_000
    assert all(np.nanmax(np.abs(s.angle_rad)) < 0.01 for s in samples if Status.OK in s.status)
    assert np.all(np.diff([s.stamp.seq for s in samples]) > 0)
    assert abs(samples[-1].stamp.t_ns - samples[-1].stamp.host_ns) < 11_000_000


@pytest.mark.parametrize("probability", [0.2, 0.5])
def test_lost_and_short_frames_mark_only_their_axes(encoder_bench, drain, probability):
    bench = encoder_bench(f"encoders:drop@0.1,probability={probability}", "encoders:truncate@0.1")
    bench.driver.open()
    samples = drain(bench, 200)
    assert bench.driver.incomplete > 20
    assert bench.driver.malformed > 10
    halves = {
        (Status.OK, Status.OK, Status.TIMEOUT, Status.TIMEOUT),
        (Status.TIMEOUT,) * 2 + (Status.OK,) * 2,
    }
    assert {s.status for s in samples[20:]} <= halves | {OK4}
    assert halves <= {s.status for s in samples}


def test_a_set_that_lacks_a_frame_does_not_wait_for_the_next(encoder_bench, drain):
    """A pause in which the bus overflowed would hand it to the first read afterwards."""
    bench = encoder_bench(options=IDEAL)
    bench.driver.open()
    last = drain(bench, 20)[-1]
    take, frames = bench.driver._link._bus.receive, []
    while not frames:  # one frame of the next set comes through
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 20_000)
        frames += [f for f in (take(),) if f is not None]
    bench.driver._link._bus.receive = lambda wait_s: frames.pop() if frames else None
    assert bench.driver.read() == ()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 90_000_000)
    assert bench.driver.read() == ()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 20_000_000)
    (half,) = bench.driver.read()
    assert half.stamp.seq == last.stamp.seq + 1
    assert half.status == (Status.OK, Status.OK, Status.TIMEOUT, Status.TIMEOUT)
    assert bench.clock.now_ns() - half.stamp.t_ns > 100_000_000
    assert bench.driver.incomplete == 1


def test_duplicates_are_seen_once(encoder_bench, drain):
    bench = encoder_bench("encoders:duplicate,probability=1")
    bench.driver.open()
    assert np.all(np.diff([s.stamp.seq for s in drain(bench, 50)]) == 1)


@pytest.mark.parametrize("fault", ["off", "bus_off", "unplug", "baud_mismatch", "intermittent"])
def test_silence_is_data_first_and_an_error_when_it_lasts(encoder_bench, drain, fault):
    options = ",duty=1" if fault == "intermittent" else ""
    bench = encoder_bench(f"encoders:{fault}@1{options}")
    bench.driver.open()
    drain(bench, 150)
    with pytest.raises(DeviceTimeoutError, match="no sample set") as caught:
        drain(bench, 100)
    assert caught.value.port == bench.driver.identity()["port"]
    assert bench.driver.error_frames == (fault in ("bus_off", "baud_mismatch"))


@pytest.mark.parametrize("fault", ["unplug", "off"])
def test_sample_sets_count_on_after_the_bus_or_the_node_was_away(encoder_bench, drain, fault):
    bench = encoder_bench(f"encoders:{fault}@1+3")
    bench.driver.open()
    before = drain(bench, 95)[-1]
    drain(bench, 50)
    for _ in range(2):
        with pytest.raises(DeviceError):
            bench.driver.reopen()
    bench.clock.sleep_until_ns(4_100_000_000)
    bench.driver.reopen()
    after = drain(bench, 100)
    assert after[-1].status == OK4
    seqs = [before.stamp.seq, *(sample.stamp.seq for sample in after)]
    assert min(b - a for a, b in itertools.pairwise(seqs)) >= 1


@pytest.mark.parametrize("fault", ["bus_off", "unplug"])
def test_the_bus_recovers_when_the_fault_ends(encoder_bench, drain, fault):
    bench = encoder_bench(f"encoders:{fault}@1+0.5")
    bench.driver.open()
    assert drain(bench, 200)[-1].status == OK4


@pytest.mark.parametrize("fault", ["encoders:off", "encoders:unplug", "encoders:baud_mismatch"])
def test_open_says_what_is_missing(encoder_bench, fault):
    bench = encoder_bench(fault)
    with pytest.raises(DeviceError, match="expected") as caught:
        bench.driver.open()
    assert caught.value.exit_code == 3
    assert bench.driver.identity() == {}
    bench.driver.close()


def test_open_names_frames_that_do_not_match_the_dbc(encoder_bench):
    bench = encoder_bench(node_id=8)
    with pytest.raises(DeviceError, match="0x1A8"):
        bench.driver.open()
    short = encoder_bench("encoders:truncate,probability=1", seed=2)
    with pytest.raises(DeviceError, match="do not match the DBC"):
        short.driver.open()


@pytest.mark.parametrize(
    ("interface", "channel"),
    [("hil", "nowhere"), ("no_such", "x"), ("socketcan", "can77"), ("slcan", "/dev/no")],
)
def test_a_bus_that_cannot_be_opened(encoder_bench, interface, channel):
    clock = encoder_bench().clock
    with pytest.raises(DeviceError, match="cannot be opened"):
        As5045Encoders(EncodersConfig(interface=interface, channel=channel), clock).open()


def test_foreign_traffic_is_passed_over(encoder_bench, drain):
    bench = encoder_bench()
    bench.driver.open()
    with can.Bus(interface="hil", channel=bench.channel.name) as other:
        for k in range(500):
            other.send(can.Message(arbitration_id=k, data=bytes(k % 9), is_extended_id=bool(k % 2)))
            other.send(can.Message(arbitration_id=416, is_remote_frame=True, is_extended_id=False))
        samples = drain(bench, 50)
    assert samples[-1].status == OK4
