"""Servos that fall silent, report errors, stand still or leap are named with what to do."""

from dataclasses import replace

import numpy as np
import pytest
from supervised import Supervised

from hil.core.errors import SafetyStop
from hil.core.signals import EncoderSample, Inputs, ServoSample, Stamp, Status, WheelSetpoint
from hil.loop.safety_limits import SafetyLimits

PERIOD_NS = 10_000_000
IDS = (11, 12, 13, 14, 15, 16, 17, 18)
ALL_SILENT = {j: Status.TIMEOUT for j in range(8)}


def supervisor(**limits):
    return Supervised(SafetyLimits(servo_ids=IDS, **limits))


def cycle(k, position=(0.0,) * 8, wrong=None, alert=(0,) * 8, encoders=None):
    """Inputs of cycle k: `wrong` is status by joint, `encoders` the four external angles."""
    t_ns, status = k * PERIOD_NS, [Status.OK] * 8
    values = np.array(position, float)
    for joint, one in (wrong or {}).items():
        status[joint], values[joint] = one, np.nan
    stamp = Stamp(t_ns, t_ns, k)
    outside = ()
    if encoders is not None:
        outside = (EncoderSample(stamp, np.array(encoders, float), (Status.OK,) * 4, (0,) * 4),)
    sample = ServoSample(stamp, values, np.zeros(8), np.zeros(8), tuple(status), alert)
    return Inputs(k, t_ns, servos=(sample,), encoders=outside)


def stopped(watch, cycles):
    """The stop that a run of cycles ends in, and what was reported before it."""
    reported = []
    for inputs in cycles:
        try:
            reported += watch.check(inputs)
        except SafetyStop as stop:
            return stop, reported
    raise AssertionError("nothing stopped the robot")


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({1: Status.TIMEOUT}, ("drive_BL (ID 12): timeout;", "cable", "supply", "ID")),
        ({5: Status.CRC, 6: Status.TIMEOUT}, ("steer_BL (ID 16): crc", "steer_BR (ID 17)", "damaged")),
        ({0: Status.HARDWARE_ERROR}, ("drive_FL (ID 11): hardware error", "reboot")),
        ({7: Status.RESET}, ("steer_FR (ID 18): reset", "supply")),
        ({3: Status.PROTOCOL}, ("drive_FR (ID 14): protocol", "same ID")),
        (ALL_SILENT, ("none of the eight answers", "supply", "bus cable", "baud rate")),
    ],
)
def test_a_silence_is_named_by_servo_id_status_and_remedy(wrong, words):
    stop, _ = stopped(supervisor(), [cycle(0)] + [cycle(k, wrong=wrong) for k in range(1, 20)])
    assert stop.reason == "stale_servos"
    assert all(word in str(stop) for word in ("no complete servo read for 0.110 s", *words))
    for joint in set(range(8)) - set(wrong):
        assert f"(ID {IDS[joint]})" not in str(stop)


@pytest.mark.parametrize("paused", [9, 40])
def test_a_pause_of_the_loop_is_no_silence_of_the_servos(paused):
    """The first reads after it may fail, too; then the limit of 0.1 s counts, and a second pause with it."""
    before, after = [cycle(k) for k in range(5)], 4 + paused
    silent = [cycle(k, wrong=ALL_SILENT) for k in range(after, after + 30)]
    watch = supervisor()
    for inputs in (*before, *silent[:9]):
        watch.check(inputs)
    stop, _ = stopped(watch, silent[9:])
    assert "no complete servo read for 0.110 s" in str(stop)
    for inputs in (*before, *silent[:5]):
        watch.check(inputs)
    with pytest.raises(SafetyStop, match="stale_servos"):
        watch.check(silent[17])


def test_who_is_silent_once_with_its_chain_is_not_blamed():
    first = [cycle(k, wrong={j: Status.TIMEOUT for j in range(3, 8)}) for k in (1, 2)]
    then = [cycle(k, wrong={3: Status.TIMEOUT}) for k in range(3, 20)]
    stop, _ = stopped(supervisor(), [cycle(0), *first, *then])
    assert "drive_FR (ID 14): timeout" in str(stop)
    assert "steer" not in str(stop)


def test_servos_that_take_turns_in_being_silent_are_all_named():
    turns = [cycle(k, wrong={2 + k % 2: Status.TIMEOUT}) for k in range(1, 20)]
    stop, _ = stopped(supervisor(), [cycle(0), *turns])
    assert "drive_BR (ID 13)" in str(stop)
    assert "drive_FR (ID 14)" in str(stop)


def test_no_read_at_all_accuses_no_servo():
    stop, _ = stopped(supervisor(), [Inputs(k, k * PERIOD_NS) for k in range(20)])
    assert "none of the eight answers" in str(stop)


def test_without_ids_the_names_are_enough():
    silent = [cycle(k, wrong={1: Status.TIMEOUT}) for k in range(20)]
    assert "drive_BL: timeout" in str(stopped(Supervised(SafetyLimits()), silent)[0])


def test_an_alert_names_its_servo_and_its_meaning():
    stop, _ = stopped(supervisor(), [cycle(0, alert=(0, 0, 0, 0, 0, 0x20, 0, 0))])
    assert stop.reason == "hardware_error"
    assert "steer_BL (ID 16)" in str(stop)
    assert "overload" in str(stop).lower()


@pytest.mark.parametrize(("joint", "step_rad"), [(0, 0.27), (3, -0.27), (4, 0.5), (7, -1.5)])
def test_a_leap_is_reported_and_then_stops_the_robot(joint, step_rad):
    after = np.where(np.arange(8) == joint, step_rad, 0.0)
    outside = [1.0, 2.0, 3.0, -3.14]
    cycles = [cycle(k, np.zeros(8) if k < 5 else after, encoders=outside) for k in range(20)]
    stop, reported = stopped(supervisor(), cycles)
    assert stop.reason == "servo_jump"
    (event,) = reported
    assert event.t_ns == 5 * PERIOD_NS
    watch = supervisor()
    assert all(watch.check(inputs) is not None for inputs in cycles[:11])  # reported first, then stopped
    assert f"(ID {IDS[joint]}) reports a step of {step_rad:+.2f} rad in 10 ms" in event.message
    assert ("external encoder" in event.message) == (joint >= 4)


def test_the_fastest_motor_does_not_leap_nor_does_one_that_was_away():
    watch = supervisor(stale_s={"servos": 1.0})
    for k in range(40):
        wrong = {2: Status.TIMEOUT} if 10 <= k < 30 else None
        assert watch.check(cycle(k, np.full(8, 0.065 * k), wrong=wrong)) == ()


def test_the_turn_of_the_encoder_beside_a_leap_is_its_own():
    watch = supervisor()
    watch.check(cycle(0, encoders=[0.0, 0.0, 0.0, 3.1]))
    leaps = np.array([0, 0, 0, 0, 0, 0, 0, 0.8])
    (event,) = watch.check(cycle(1, leaps, encoders=[0.0, 0.0, 0.0, -3.1]))
    assert "external encoder FR turned by 0.08 rad" in event.message
    watch.reset()
    (event,) = (*watch.check(cycle(0)), *watch.check(cycle(1, leaps)))
    assert "encoder" not in event.message


def asked(watch, rates):
    watch.limit(WheelSetpoint(np.array(rates, float), np.zeros(4)))


@pytest.mark.parametrize(
    ("rate", "angle", "last"),
    [(0.51, 0.0, 51), (-0.51, 0.049, 51), (0.49, 0.0, 69), (0.51, 0.06, 69), (-0.51, -0.06, 69)],
)
def test_a_wheel_that_is_asked_to_turn_must_turn(rate, angle, last):
    """More than 0.05 rad within 0.5 s, once more than 0.5 rad/s is asked for."""
    watch, done, stop = supervisor(), 0, None
    turned = np.where(np.arange(8) == 2, angle, 0.0)
    for k in range(70):
        try:
            watch.check(cycle(k, np.zeros(8) if k < 25 else turned))
        except SafetyStop as error:
            stop = error
            break
        asked(watch, [0.0, 0.0, rate, 0.0])
        done = k
    assert done == last
    if last < 69:
        assert stop.reason == "blocked"
        assert f"wheel BR is asked for {rate:.2f} rad/s and has not turned for 0.5 s" in str(stop)


@pytest.mark.parametrize("angle", [2.0, -30.0])
def test_a_wheel_is_blocked_at_whatever_angle_it_stands(angle):
    watch = supervisor()

    def driven():
        for k in range(70):
            yield cycle(k, np.full(8, angle))
            asked(watch, [0.0, 2.0, 0.0, 0.0])

    stop, _ = stopped(watch, driven())
    assert stop.reason == "blocked"
    assert "wheel BL" in str(stop)


@pytest.mark.parametrize("lost_every", [2, 40])
def test_lost_reads_hide_no_blocked_wheel(lost_every):
    watch = supervisor()

    def driven():
        for k in range(70):
            yield cycle(k, wrong=None if k % lost_every else {1: Status.TIMEOUT})
            asked(watch, [0.0, 2.0, 0.0, 0.0])

    stop, _ = stopped(watch, driven())
    assert stop.reason == "blocked"
    assert "wheel BL" in str(stop)


@pytest.mark.parametrize("joint", [0, 5])
def test_a_leap_behind_a_short_silence_is_reported_against_the_last_angle_known(joint):
    watch = supervisor()
    watch.check(cycle(0))
    for k in (1, 2):
        assert watch.check(cycle(k, wrong={joint: Status.TIMEOUT})) == ()
    (event,) = watch.check(cycle(3, np.where(np.arange(8) == joint, 0.6, 0.0)))
    assert f"(ID {IDS[joint]}) reports a step of +0.60 rad in 30 ms" in event.message


def test_one_servo_that_misses_every_other_read_is_named_and_no_other():
    """Nothing stops: a complete read comes every 20 ms. The two behind it in the chain miss a few reads."""
    watch, reported = supervisor(), []
    for k in range(300):
        wrong = {4: Status.TIMEOUT} if k % 2 else {}
        if k % 20 == 1:
            wrong |= {5: Status.TIMEOUT, 6: Status.TIMEOUT}
        reported += watch.check(cycle(k, wrong=wrong))
    assert [(e.level, e.source) for e in reported] == [("warning", "servos")]
    assert "steer_FL (ID 15)" in reported[0].message
    assert "ID 16" not in reported[0].message
    assert reported[0].t_ns < 600_000_000


def test_single_lost_reads_are_not_reported():
    watch = supervisor()
    assert not [e for k in range(300) for e in watch.check(cycle(k, wrong={} if k % 20 else {0: Status.CRC}))]


def test_wheels_wait_while_commands_may_arrive_and_answers_do_not():
    """No watchdog of the servos trips then, and the robot would go on until the stop."""
    watch, asked = supervisor(), WheelSetpoint(np.full(4, 3.0), np.full(4, 0.2))
    rates = []
    for k in range(20):
        watch.check(cycle(k, wrong=ALL_SILENT if 5 <= k < 14 else {}))
        limited = watch.limit(asked)
        rates.append(float(limited.wheel_rate_rad_s[0]))
        np.testing.assert_array_equal(limited.steering_rad, asked.steering_rad)
    assert rates[:9] == [3.0] * 9
    assert rates[10:14] == [0.0] * 4
    assert rates[14:] == [3.0] * 6


def test_a_device_that_holds_up_the_loop_is_named_once_a_second():
    watch, reported = supervisor(), []
    for k in range(250):
        slow_ns = {"imu": 15_000_000, "tracker": 35_000_000} if k > 20 else {}
        reported += watch.check(replace(cycle(k), slow_ns=slow_ns))
    assert [(e.level, e.source) for e in reported] == [("warning", "tracker")] * 3
    assert "35 ms" in reported[0].message
