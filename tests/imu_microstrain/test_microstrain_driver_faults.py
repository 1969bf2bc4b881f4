"""What goes wrong is said in the samples, lasts only as long as its cause, and raises when it persists."""

import dataclasses
import itertools

import numpy as np
import pytest

from hil.core.errors import DeviceTimeoutError
from hil.core.signals import Status
from hil.fakes.imu.microstrain.commands import Settings
from hil.fakes.serial_chip import Reply
from hil.faults.fault import parse_fault
from hil.links.mip import fields as f
from hil.links.mip.packets import Field, cut, encode


def kinds(samples):
    return {s.status for s in samples}


def opened(bench, *faults, **options):
    b = bench(*faults, **options)
    b.driver.open()
    assert kinds(b.run(0.2)) == {Status.OK}
    return b


def during(b, spec, duration_s=1.0):
    """Samples while a fault acts, and those of the second after it."""
    b.world.faults.add(parse_fault(spec))
    struck = b.run(duration_s)
    b.world.faults.clear()
    return struck, b.run(1.0)


@pytest.mark.parametrize(
    ("spec", "allowed", "always"),
    [
        ("imu:off", {Status.TIMEOUT}, Status.TIMEOUT),
        ("imu:unplug", {Status.TIMEOUT}, Status.TIMEOUT),
        ("imu:stuck", {Status.OK, Status.FROZEN}, Status.FROZEN),
        ("imu:garbage", {Status.TIMEOUT, Status.PROTOCOL, Status.CRC}, Status.PROTOCOL),
        ("imu:intermittent,period_s=0.05", {Status.OK}, Status.OK),
        ("imu:intermittent,period_s=0.6", {Status.OK, Status.TIMEOUT}, Status.TIMEOUT),
        ("imu:slow,factor=5", {Status.OK}, Status.OK),
        ("imu:delayed,delay_s=0.03", {Status.OK}, Status.OK),
        ("imu:delayed,delay_s=0.3", {Status.OK, Status.STALE, Status.TIMEOUT}, Status.STALE),
        ("imu:wrong", {Status.OK}, Status.OK),
        ("imu:jump", {Status.OK}, Status.OK),
        ("imu:duplicate,probability=0.05", {Status.OK}, Status.OK),
        ("imu:drop,probability=0.2", {Status.OK}, Status.OK),
        ("imu:corrupt,probability=0.2", {Status.OK, Status.CRC}, Status.CRC),
    ],
)
def test_a_fault_shows_and_passes(bench, spec, allowed, always):
    b = opened(bench)
    struck, after = during(b, spec)
    assert always in kinds(struck)
    assert kinds(struck[5:]) <= allowed | {Status.OK}
    restart = {Status.RESET, Status.STARTING, Status.TIMEOUT, Status.PROTOCOL, Status.STALE, Status.CRC}
    assert kinds(after) <= restart | {Status.OK, Status.FROZEN}
    later = b.run(1.5)
    assert kinds(later[-50:]) == {Status.OK}
    assert len(later) == pytest.approx(167, abs=70)


def test_sequence_and_time_never_go_back(bench):
    b = opened(bench)
    seen = []
    for spec in ("imu:slow,factor=8", "imu:delayed,delay_s=0.05", "imu:reset", "imu:intermittent"):
        struck, after = during(b, spec)
        seen += [*struck, *after]
    assert all(d == 1 for d in np.diff([s.stamp.seq for s in seen]))
    good = [s.stamp for s in seen if s.status is Status.OK]
    assert np.all(np.diff([s.t_ns for s in good]) > 0)
    assert all(s.t_ns <= s.host_ns for s in good)


def test_slow_delayed_wrong_and_jump_are_in_the_data(bench, turning_plant):
    b = opened(bench, plant=turning_plant(tilt_rad=0.0))
    struck, _ = during(b, "imu:slow,factor=5")
    assert len(struck) == pytest.approx(22, abs=3)
    struck, _ = during(b, "imu:wrong,rate_rad_s=0.3")
    np.testing.assert_allclose(np.mean([s.gyro_rad_s for s in struck[2:]], axis=0), [0.3] * 3, atol=0.003)
    before = b.run(0.1)[-1]
    struck, after = during(b, "imu:jump,angle_rad=0.4")
    assert abs(np.dot(before.quaternion_wxyz, after[-1].quaternion_wxyz)) == pytest.approx(
        np.cos(0.2), abs=1e-3
    )
    struck, _ = during(b, "imu:delayed,delay_s=0.05")
    late_ns = [s.stamp.host_ns - s.stamp.t_ns for s in struck[20:]]
    assert np.mean(late_ns) == pytest.approx(0.065e9, abs=0.008e9)


def test_a_restarted_sensor_is_set_up_again_and_says_so(bench):
    b = opened(bench)
    seen = []
    b.world.faults.add(parse_fault("imu:reset@0.5"))
    seen += b.run(3.0)
    states = [k for k, _ in itertools.groupby(s.status for s in seen)]
    assert states == [Status.OK, Status.TIMEOUT, Status.RESET, Status.STARTING, Status.OK]
    silent = [s.stamp.host_ns for s in seen if s.status is Status.TIMEOUT]
    assert np.diff(silent).min() >= 20_000_000
    assert not b.chip.commands.settings.magnetometer
    assert seen[-1].stamp.t_ns > b.clock.now_ns() - 30_000_000


@pytest.mark.parametrize("boot_s", [0.05, 1.0])
def test_a_sensor_that_restarts_into_the_same_stream_still_gets_its_settings(bench, ideal, boot_s):
    """What it says before is in other axes: it is not passed on, should the sensor not stop as asked."""
    quick = dataclasses.replace(ideal, boot_s=boot_s, initialisation_s=0.0, gyro_noise_rad_s=0.001)
    b = opened(bench, options=quick)
    formats = b.chip.commands.settings.formats
    b.chip.commands.saved = Settings(formats, transform_rad=(0.0, 0.0, 0.1))
    b.chip.commands._known[f.BASE, f.SET_IDLE] = lambda data: (f.DONE, ())
    b.world.faults.add(parse_fault("imu:reset@0.5"))
    seen = b.run(3.5)
    assert [s.status for s in seen].count(Status.RESET) == 1
    assert kinds(seen[-20:]) == {Status.OK}
    assert not b.chip.commands.settings.magnetometer
    assert b.chip.commands.settings.transform_rad == (0.0, 0.0, 0.0)
    for sample in seen:
        if sample.status is Status.OK:
            np.testing.assert_allclose(sample.gravity_m_s2, [9.80665, 0.0, 0.0], atol=1e-4)


def test_a_client_that_changes_the_format_is_put_right(bench):
    b = opened(bench)
    b.chip.receive(
        encode(
            f.THREE_DM, [Field(f.MESSAGE_FORMAT, b"\x01" + f.format_data(f.FILTER_DATA, ((f.STATUS, 9),)))]
        ),
        b.clock.now_ns(),
        115_200,
    )
    seen = b.run(1.0)
    assert Status.TIMEOUT in kinds(seen)
    assert kinds(seen[-20:]) == {Status.OK}


@pytest.mark.parametrize(
    ("spec", "reason"),
    [
        ("imu:off", "the sensor is silent"),
        ("imu:unplug", "port cannot be opened"),
        ("imu:garbage", "what comes is no MIP packet"),
        ("imu:delayed,delay_s=0.3", "last status stale"),
        ("imu:corrupt,probability=1", "packets are spoilt on the way"),
    ],
)
def test_what_lasts_raises_with_its_reason_and_a_remedy(bench, spec, reason):
    b = opened(bench, config={"fail_after_s": 2.0})
    b.world.faults.add(parse_fault(spec))
    with pytest.raises(DeviceTimeoutError, match=rf"nothing usable for 2\.. s \({reason}") as caught:
        b.run(10.0)
    assert "check power, wiring and baud rate" in str(caught.value)
    assert "hil://imu" in str(caught.value)
    b.driver.close()
    b.driver.close()


class Altered:
    """The chip with its data altered on the way out."""

    def __init__(self, chip, alter):
        self._chip, self._alter = chip, alter

    def __getattr__(self, name):
        return getattr(self._chip, name)

    def poll(self, t_ns):
        return [Reply(r.ready_ns, self._alter(r.data)) for r in self._chip.poll(t_ns)]


def with_field(descriptor, *values):
    """Alters a field of every data packet."""

    def alter(data):
        found = cut(data[4:-2])
        changed = [
            Field(d, f.LAYOUTS[d].pack(*values)) if d == descriptor else Field(d, old) for d, old in found
        ]
        return encode(f.FILTER_DATA, changed)

    return alter


@pytest.mark.parametrize(
    ("alter", "status"),
    [
        (with_field(f.STATUS, 1, 1, 0), Status.STARTING),
        (with_field(f.STATUS, 2, 1, 0x4000), Status.HARDWARE_ERROR),
        (with_field(f.STATUS, 2, 1, 0x000C), Status.OK),
        (with_field(f.QUATERNION, float("nan"), 0, 0, 0, 1), Status.NOT_FINITE),
        (with_field(f.QUATERNION, 0.9, 0, 0, 0, 1), Status.IMPLAUSIBLE),
        (with_field(f.ANGULAR_RATE, 0, 0, 0, 0), Status.STARTING),
        (with_field(f.ANGULAR_RATE, 0, float("inf"), 0, 1), Status.NOT_FINITE),
        (with_field(f.ANGULAR_RATE, 0, 0, 50, 1), Status.IMPLAUSIBLE),
        (with_field(f.GRAVITY, 0, 0, 9.0, 1), Status.IMPLAUSIBLE),
        (with_field(f.GRAVITY, 0, 0, 9.83, 1), Status.OK),
    ],
)
def test_what_the_data_say_of_themselves(bench, alter, status):
    b = opened(bench)
    b.line.chip = Altered(b.chip, alter)
    b.run(0.1)
    assert kinds(b.run(0.1)) == {status}


def test_nothing_is_read_before_it_has_come_without_waiting(bench):
    b = opened(bench, config={"rate_hz": 10.0})
    longest_ns = 0
    for _ in range(200):
        before_ns = b.clock.now_ns()
        b.driver.read()
        longest_ns = max(longest_ns, b.clock.now_ns() - before_ns)
        b.clock.sleep_until_ns(before_ns + 2_000_000)
    assert longest_ns <= 50_000


@pytest.mark.parametrize("fault", ["imu:off", "imu:unplug", "imu:garbage", "imu:reset"])
def test_the_loop_does_not_wait_for_a_sensor_that_is_set_up_again(bench, fault):
    b = opened(bench)
    b.world.faults.add(parse_fault(fault))
    longest_ns = 0
    for k in range(300):
        before_ns = b.clock.now_ns()
        b.driver.read()
        longest_ns = max(longest_ns, b.clock.now_ns() - before_ns)
        b.clock.sleep_until_ns(before_ns + 10_000_000)
        if k == 100:
            b.world.faults.clear()
    assert longest_ns <= 50_000
