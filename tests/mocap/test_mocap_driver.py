"""The driver against the emulated capture server in virtual time: poses, times, versions, refusals."""

import math

import natnet_builder as build
import numpy as np
import pytest

from hil.config.mocap import MocapConfig
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import Status
from hil.drivers.mocap.natnet.driver import NatNetMocap
from hil.fakes.mocap.natnet.true_parameters import MocapTruthOptions
from hil.links.udp_ports import Datagram

NOISY = MocapTruthOptions(stalls_per_s=0.0)


def heading(sample):
    w, x, y, z = sample.quaternion_wxyz
    assert max(abs(x), abs(y)) < 2e-4
    return 2 * math.atan2(z, w)


@pytest.mark.parametrize(("version", "up_axis"), [((3, 1), "y"), ((4, 0), "z"), ((4, 1), "y")])
def test_poses_are_those_of_the_body_on_the_wall(mocap_bench, watch, version, up_axis):
    bench = mocap_bench(config={"up_axis": up_axis}, version=version)
    bench.driver.open()
    samples = watch(bench, 2.0)
    assert len(samples) == pytest.approx(200, abs=2)
    for s in samples:
        x, y, theta = bench.plant.pose(s.stamp.t_ns)
        np.testing.assert_allclose(s.position_m, [x, y, 0.08], atol=2e-6)
        assert heading(s) == pytest.approx(theta, abs=2e-6)
        assert s.status is Status.OK
        assert s.tracking_valid
        assert s.latency_s == pytest.approx(0.004, abs=1e-6)
        assert s.marker_error_m == pytest.approx(0.0002, rel=0.5)
    assert np.all(np.diff([s.stamp.seq for s in samples]) == 1)
    assert bench.driver.identity()["natnet"] == "{}.{}".format(*version)
    assert bench.driver.identity()["model"] == "Motive"


def test_stamps_are_exposures_on_the_bench_clock_despite_drift_and_jitter(mocap_bench, watch, climber):
    bench = mocap_bench(options=MocapTruthOptions(clock_ppm=60.0), plant=climber(velocity=(0.3, 0.0)), seed=3)
    bench.driver.open()
    samples = [s for s in watch(bench, 10.0) if s.stamp.t_ns > 2e9]
    error_s = [(s.position_m[0] - bench.plant.pose(s.stamp.t_ns)[0]) / 0.3 for s in samples]
    assert abs(np.mean(error_s)) < 0.5e-3
    assert np.std(error_s) < 0.3e-3
    assert all(s.stamp.host_ns > s.stamp.t_ns for s in samples)


def test_noise_and_gaps_are_those_measured(mocap_bench, watch, climber):
    bench = mocap_bench(options=NOISY, plant=climber(velocity=(0.0, 0.0), rate=0.0))
    bench.driver.open()
    samples = watch(bench, 40.0)
    assert np.std([s.position_m for s in samples], axis=0) == pytest.approx(10e-6, rel=0.1)
    assert np.std([heading(s) for s in samples]) == pytest.approx(40e-6, rel=0.1)
    steps = np.diff([s.stamp.seq for s in samples])
    assert 25 <= np.count_nonzero(steps > 1) <= 76
    assert 0.3 < np.mean(steps[steps > 1] == 2) < 0.75


@pytest.mark.parametrize("body", ["robot", 1])
def test_the_body_is_found_by_name_or_id(mocap_bench, watch, body):
    bench = mocap_bench(config={"body": body})
    bench.driver.open()
    assert watch(bench, 0.1)[-1].position_m[0] == pytest.approx(0.3, abs=0.05)
    assert bench.driver.identity()["body"].endswith("(id 1)")


@pytest.mark.parametrize("body", ["robbie", 7])
def test_an_unknown_body_is_refused_with_those_that_exist(mocap_bench, body):
    with pytest.raises(DeviceError, match=r"no rigid body.*'robot' \(id 1\), 'distractor' \(id 2\)"):
        mocap_bench(config={"body": body}).driver.open()


def test_another_bit_stream_is_asked_for_and_kept_over_a_restart(mocap_bench, watch):
    bench = mocap_bench("mocap:reset@2", config={"natnet_version": "3.1"}, version=(4, 1))
    bench.driver.open()
    assert bench.driver.identity()["natnet"] == "3.1"
    assert {s.status for s in watch(bench, 1.0)} == {Status.OK}
    watch(bench, 3.0)
    assert {s.status for s in watch(bench, 1.0)} == {Status.OK}


@pytest.mark.parametrize(("version", "wanted"), [((4, 0), "4.1"), ((3, 1), "3.0")])
def test_a_bit_stream_that_the_server_does_not_offer_is_refused(mocap_bench, version, wanted):
    with pytest.raises(DeviceError, match=f"expected NatNet {wanted}") as caught:
        mocap_bench(config={"natnet_version": wanted}, version=version).driver.open()
    assert caught.value.remedy


class Post:
    """Datagram ports fed by a test: a server of its own making."""

    def __init__(self, clock, answers, sender=("127.0.0.1", 1510)):
        self.clock, self.answers, self.sender = clock, answers, sender
        self.queue, self.asked, self.closed = [], [], 0

    def __call__(self, group, port):
        return self

    def put(self, data, sender=None):
        self.queue.append(Datagram(data, sender or self.sender, self.clock.now_ns()))

    def send(self, data, address):
        self.asked.append(data)
        for answer in self.answers.get(data[0], ()):
            self.put(answer)

    def receive(self):
        return self.queue.pop(0) if self.queue else None

    def close(self):
        self.closed += 1


def posted(mocap_bench, answers, **values):
    bench = mocap_bench()
    post = Post(bench.clock, answers)
    config = MocapConfig(**{"open_timeout_s": 0.5, **values})
    return bench, post, NatNetMocap(config, bench.clock, datagrams=post)


def talk(version=(4, 1), **info):
    """Answers of a server: its description, one body, one frame."""
    return {
        0: [build.server_info(version, **info), build.frame(version, 5, [build.body(1)])],
        4: [build.models(version, (1, build.body_model(version, "robot", 1)))],
    }


def test_a_server_too_old_is_refused(mocap_bench):
    _, post, driver = posted(mocap_bench, {0: [build.server_info((2, 9), short=True)]})
    with pytest.raises(DeviceError, match=r"2\.9"):
        driver.open()
    assert post.closed == 2
    assert driver.identity() == {}


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        ({}, "no server answers"),
        ({0: [build.server_info()]}, "no model definitions"),
        ({0: [build.server_info()], 4: talk()[4]}, "sends no frames"),
        ({0: [build.server_info()[:100], b"\x01", b"noise"]}, "no server answers, packets passed over: "),
    ],
)
def test_whatever_stays_away_is_named(mocap_bench, answers, message):
    bench, _, driver = posted(mocap_bench, answers)
    with pytest.raises(DeviceTimeoutError, match=message) as caught:
        driver.open()
    assert caught.value.remedy
    assert bench.clock.now_ns() < 1_000_000_000


def test_strangers_and_damaged_packets_are_counted_and_passed_over(mocap_bench):
    bench, post, driver = posted(mocap_bench, talk())
    driver.open()
    frame = build.frame((4, 1), 6, [build.body(1, (9, 9, 9))])
    post.put(frame, ("10.0.0.9", 1510))
    post.put(build.server_info((3, 0)), ("127.0.0.1", 9999))
    post.put(frame[:-3])
    post.put(b"")
    post.put(frame, ("127.0.0.1", 1600))
    post.put(build.frame((4, 1), 5, [build.body(1)]))
    assert driver.read() == ()
    assert driver.counts == {"malformed": 2, "strangers": 3, "repeated": 1, "overflowed": 0, "floods": 0}
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 1_100_000_000)
    post.put(frame, ("127.0.0.1", 1600))
    assert driver.read()[0].position_m.tolist() == [9, -9, 9]


def test_frames_before_their_time_are_dropped_and_a_counter_gone_back_is_a_restart(mocap_bench):
    bench, post, driver = posted(mocap_bench, talk())
    driver.open()

    def send(number):
        post.put(build.frame((4, 1), number, [build.body(1, (1, 2, 3 + number * 1e-6))]))
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
        return driver.read()

    assert len(send(7)) == 1
    assert send(6) == ()
    assert len(send(8)) == 1
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 500_000_000)
    first = send(2)[0]
    assert first.status is Status.RESET
    assert first.stamp.seq == 9
    assert send(3)[0].stamp.seq == 10


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (build.body(1, rotation=(0, 0, 0, 1.03)), Status.IMPLAUSIBLE),
        (build.body(1, position=(1001, 0, 0)), Status.IMPLAUSIBLE),
        (build.body(1, position=(math.inf, 0, 0)), Status.NOT_FINITE),
        (build.body(1, flags=0), Status.NOT_TRACKED),
        (build.body(2), Status.NOT_TRACKED),
    ],
)
def test_what_cannot_be_a_pose_is_no_number(mocap_bench, body, status):
    _, post, driver = posted(mocap_bench, talk())
    driver.open()
    post.put(build.frame((4, 1), 6, [body]))
    (sample,) = driver.read()
    assert sample.status is status
    assert np.isnan(sample.position_m).all()
    assert np.isnan(sample.quaternion_wxyz).all()


@pytest.mark.parametrize(
    ("clock_hz", "suffix"),
    [
        (0, (0, 0, 12.5, 1000, 1400, 2000)),
        (10_000_000, (0, 0, 12.5, 0, 0, 0)),
        (10_000_000, (0, 0, math.nan, 3000, 1400, 2000)),
    ],
)
def test_without_exposure_stamps_the_frame_time_serves_and_latency_is_unknown(mocap_bench, clock_hz, suffix):
    bench, post, driver = posted(mocap_bench, talk(clock_hz=clock_hz))
    driver.open()
    post.put(build.frame((4, 1), 6, [build.body(1)], suffix=suffix))
    (sample,) = driver.read()
    assert math.isnan(sample.latency_s)
    assert 0 <= sample.stamp.host_ns - sample.stamp.t_ns < 5_000_000 or sample.status is Status.STALE
    assert sample.stamp.host_ns == bench.clock.now_ns()


def test_changed_models_are_asked_for_again(mocap_bench):
    _, post, driver = posted(mocap_bench, talk())
    driver.open()
    post.asked.clear()
    post.put(build.frame((4, 1), 6, [build.body(1)], flags=2))
    post.answers[4] = [build.models((4, 1), (1, build.body_model((4, 1), "robot", 8)))]
    driver.read()
    assert [data[0] for data in post.asked] == [4]
    post.put(build.frame((4, 1), 7, [build.body(1), build.body(8, (5, 6, 7))]))
    assert driver.read()[-1].position_m.tolist() == [5, -7, 6]


def test_a_body_that_is_deleted_is_an_error_after_a_while(mocap_bench, watch):
    bench, post, driver = posted(mocap_bench, talk(), fail_after_s=1.0)
    driver.open()
    post.answers[4] = [build.models((4, 1))]
    post.put(build.frame((4, 1), 6, [], flags=2))
    driver.read()
    bench.driver = driver
    with pytest.raises(DeviceTimeoutError, match="no usable frame"):
        watch(bench, 2.0)


def test_ports_that_cannot_be_used_are_a_device_error(mocap_bench):
    bench = mocap_bench()

    def taken(group, port):
        raise OSError(98, "Address already in use")

    with pytest.raises(DeviceError, match=r"UDP ports cannot be used.*in use.*local_address"):
        NatNetMocap(bench.config, bench.clock, datagrams=taken).open()


def test_a_taken_data_port_matters_for_multicast_only(mocap_bench, watch):
    bench = mocap_bench()
    other = bench.server.datagrams(None, 1511)
    bench.driver.open()
    assert len(watch(bench, 0.5)) == pytest.approx(50, abs=2)
    other.close()

    def group_taken(group, port):
        if group is not None:
            raise OSError(98, "Address already in use")
        return bench.server.datagrams(group, port)

    config = MocapConfig(multicast="239.255.42.99")
    with pytest.raises(DeviceError, match="UDP ports"):
        NatNetMocap(config, bench.clock, datagrams=group_taken).open()


def test_a_client_that_gives_no_sign_of_life_is_forgotten(mocap_bench, watch):
    bench = mocap_bench(config={"keepalive_s": 60.0, "reconnect_after_s": 60.0, "fail_after_s": 3.0})
    bench.driver.open()
    assert len(watch(bench, 9.5)) > 900
    with pytest.raises(DeviceTimeoutError, match="no usable frame"):
        watch(bench, 5.0)
    patient = mocap_bench()
    patient.driver.open()
    assert watch(patient, 13.0)[-1].stamp.t_ns > 12.9e9


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"server": "motive.local"}, "server"),
        ({"multicast": "10.0.0.1"}, "multicast"),
        ({"body": ""}, "body"),
        ({"natnet_version": "2.9"}, "natnet_version"),
    ],
)
def test_a_configuration_that_cannot_be_meant_is_refused(values, message):
    with pytest.raises(ValueError, match=message):
        MocapConfig(**values)


def test_a_frame_that_comes_again_after_a_pause_is_no_restart(mocap_bench):
    """By the other port, from a thread that the host has kept waiting: seen before, however late."""
    bench, post, driver = posted(mocap_bench, talk())
    driver.open()

    def frame(number, begun_s):
        up_s = begun_s + 0.01 * number
        ticks = (round(up_s * 1e7), round(up_s * 1e7) + 400, round(up_s * 1e7) + 1000)
        return build.frame((4, 1), number, [build.body(1)], suffix=(0, 0, up_s, *ticks))

    for number in range(1000, 1010):
        post.put(frame(number, 3.0))
    assert len(driver.read()) == 10
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 400_000_000)
    post.put(frame(1004, 3.0))
    post.put(frame(1009, 3.0))
    assert driver.read() == ()
    assert driver.counts["repeated"] == 2
    post.put(frame(1005, 0.0))
    (begun_anew,) = driver.read()
    assert begun_anew.stamp.seq > 1009


def test_240_frames_per_second_are_all_delivered(mocap_bench, watch):
    bench = mocap_bench(options=MocapTruthOptions(rate_hz=240.0, gaps_per_s=0.0, stalls_per_s=0.0))
    bench.driver.open()
    assert len(watch(bench, 2.0)) == pytest.approx(480, abs=3)
