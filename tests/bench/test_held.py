"""After every stop the hold is checked: servos that restart are caught, and HELD is said only where true."""

import numpy as np
import pytest

import hil
from hil.core.errors import ConfigError, DeviceError, HilError, SafetyStop, UsageError
from hil.core.signals import SERVOS
from hil.faults.fault import parse_fault
from hil.robot.trajectories import line
from tests.patience import FANLESS

SECOND = 1_000_000_000
CLIMB = line((0, 0, 0), (0.15, 0, 0), duration_s=4.0)
MOVING_S, STOPPED_S = 2.5, 8.0
REST_RAD_S = 0.1  # 2.5 mm/s


def place(bench):
    return bench.truth().pose_body_in_wall[:2].copy()


def wait(bench, duration_s):
    bench.clock.sleep_until_ns(bench.clock.now_ns() + round(duration_s * SECOND))


def moved_from(bench, duration_s):
    """How far the robot gets in a time without calls, mm."""
    start, farthest = place(bench), 0.0
    for _ in range(round(duration_s / 0.05)):
        wait(bench, 0.05)
        farthest = max(farthest, float(np.linalg.norm(place(bench) - start)))
    return 1e3 * farthest


def climb(bench):
    """Drive, whatever becomes of it; the stop that ended it."""
    try:
        bench.drive(CLIMB)
    except SafetyStop as stop:
        return stop
    return None


LOSSES = [
    ("servos:brownout", 0.05),
    ("servos:brownout", 0.3),
    ("servos:brownout", 1.0),
    ("servos:reset", 0.0),
    ("servos:unplug", 1.0),
    ("servo.drive_FL:brownout", 0.3),
    ("servo.steer_BR:reset", 0.0),
    ("servo.drive_BL:off", 1.0),
]


def fault(kind, at_s, duration_s):
    return f"{kind}@{at_s}" + (f"+{duration_s}" if duration_s else "")


LOST = [
    pytest.param(kind, duration_s, at_s, id=f"{moment}-{kind}-{duration_s}", marks=marks)
    for moment, at_s, breadth in (("in motion", MOVING_S, ()), ("after the stop", STOPPED_S, LOSSES[2:7]))
    for kind, duration_s in LOSSES
    for marks in [pytest.mark.long if (kind, duration_s) in breadth else ()]
]
"""Losses in motion, and a few of them after the stop; all of them in the long run."""


@pytest.mark.parametrize(("kind", "duration_s", "at_s"), LOST)
def test_lost_servos_come_back_without_calling_anything(kind, duration_s, at_s):
    with hil.open_bench(
        "emulated", seed=3, faults=[fault(kind, at_s, duration_s)], overrides=FANLESS
    ) as bench:
        stop = climb(bench)
        assert (stop is None) == (at_s > MOVING_S)
        back_s = at_s + duration_s
        wait(bench, max(0.0, back_s + 0.3 - bench.clock.now_ns() / SECOND))
        assert not bench.devices.servos.look_after().trouble
        assert moved_from(bench, 1.0) < 2.0
        assert bench.look().state == "HELD"
    assert bench.held.state == "HELD"
    assert bench.held.moved_m < 0.03


def test_a_loss_while_the_bench_opens():
    with hil.open_bench("emulated", seed=3, faults=["servos:unplug@0.1+0.8"], overrides=FANLESS) as bench:
        assert bench.look().state == "HELD"
        assert moved_from(bench, 1.0) < 0.3


OPENING = {"asked": 0.2, "set up": 0.41, "enabled": 0.43}


@pytest.mark.parametrize("at_s", list(OPENING.values()), ids=list(OPENING))
@pytest.mark.parametrize(
    ("kind", "duration_s"),
    [
        ("servos:brownout", 0.05),
        ("servos:reset", 0.0),
        ("servos:unplug", 0.3),
        ("servo.steer_FL:brownout", 0.05),
        ("servo.drive_BL:off", 1.0),
    ],
)
def test_whenever_it_happens_while_the_bench_opens_the_robot_is_held_in_the_end(kind, duration_s, at_s):
    with hil.open_bench(
        "emulated", seed=3, faults=[fault(kind, at_s, duration_s)], overrides=FANLESS
    ) as bench:
        wait(bench, max(0.0, at_s + duration_s + 0.3 - bench.clock.now_ns() / SECOND))
        assert not bench.devices.servos.look_after().trouble
        assert moved_from(bench, 1.0) < 2.0
    assert bench.held.state == "HELD"


def test_servos_that_do_not_come_back_while_they_are_enabled_are_named_in_time():
    with hil.open_bench("emulated", seed=1) as bench:
        began_s = bench.clock.now_ns() / SECOND
        bench.world.faults.add(parse_fault(f"servo.drive_BL:off@{began_s}"))
        wait(bench, 0.01)
        with pytest.raises(DeviceError, match="drive_BL timeout"):
            bench.devices.servos.enable()
        assert 1.4 < bench.clock.now_ns() / SECOND - began_s < 2.0


@pytest.mark.long
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("at_s", [0.1, MOVING_S, STOPPED_S])
@pytest.mark.parametrize(
    ("kind", "duration_s"), [*LOSSES, ("servos:brownout", 0.6), ("servo.steer_FL:off", 0.5)]
)
def test_lost_servos_come_back_in_five_worlds(kind, duration_s, at_s, seed):
    with hil.open_bench(
        "emulated", seed=seed, faults=[fault(kind, at_s, duration_s)], overrides=FANLESS
    ) as bench:
        climb(bench)
        wait(bench, max(0.0, at_s + duration_s + 0.3 - bench.clock.now_ns() / SECOND))
        assert not bench.devices.servos.look_after().trouble
        assert moved_from(bench, 1.0) < 2.0
    assert bench.held.state == "HELD"


def test_while_the_servos_are_away_it_says_so_and_why():
    bench = hil.open_bench(
        "emulated", seed=1, faults=["servos:off@2.5"], overrides={**FANLESS, "exit.look_after_s": 1.0}
    )
    with bench:
        assert climb(bench) is not None
        now = bench.look()
        assert now.state == "NOT HELD"
        assert "no servo answers" in now.why
        started = place(bench)
    slid_m = float(np.linalg.norm(place(bench) - started))
    assert bench.held.state == "NOT HELD"
    assert bench.held.moved_m == pytest.approx(slid_m, abs=0.02)
    assert slid_m > 0.01


def test_one_dead_servo_is_named_with_its_id():
    with hil.open_bench(
        "emulated", seed=1, faults=["servo.drive_BR:off@2.5"], overrides={**FANLESS, "exit.look_after_s": 1.0}
    ) as bench:
        climb(bench)
    assert bench.held.state == "NOT HELD"
    assert "drive_BR (ID 3: timeout)" in bench.held.why


def test_a_robot_that_came_off_is_not_held_though_every_servo_has_torque():
    bench = hil.open_bench("emulated", seed=1, faults=["plant:adhesion_loss@1.5"], overrides=FANLESS)
    with bench:
        bench.observe(0.2)
        wait(bench, 2.0 - bench.clock.now_ns() / SECOND)
        assert not bench.devices.servos.look_after().trouble
    assert bench.held.state == "NOT HELD"
    assert "adhesion is lost" in bench.held.why
    assert bench.held.moved_m > 0.1


def left_without_servos(**how):
    with hil.open_bench(
        "emulated", seed=1, faults=["servos:off@1"], overrides={**FANLESS, "exit.look_after_s": 1.0}
    ) as bench:
        for name, value in how.items():
            setattr(bench, name, value)
        wait(bench, 1.0)
    bench.close()
    return bench


def test_a_script_that_leaves_the_robot_falling_is_warned_once(caplog):
    bench = left_without_servos()
    reported = [r.getMessage() for r in caplog.records if r.name == "hil.bench.hold.held_devices"]
    assert reported == [f"bench emulated: the robot is left {bench.held}"]
    assert bench.held.lost


def test_a_program_that_reports_it_otherwise_is_not_warned(caplog):
    assert left_without_servos(warns_not_held=False).held.lost
    with hil.open_bench("emulated_floor", seed=1, faults=["servos:off@1"]) as bench:
        wait(bench, 1.0)
    assert not bench.held.lost
    assert "is left" not in caplog.text


def test_hardware_errors_are_reported():
    with hil.open_bench("emulated", seed=1, overrides={**FANLESS, "exit.look_after_s": 1.0}) as bench:
        bench.observe(0.2)
        servos = bench.world._parts[0].servos
        servos[SERVOS.index("steer_BL")].raise_error(0x20)
    assert bench.held.state == "NOT HELD"
    assert "steer_BL (ID 6: hardware error: overload" in bench.held.why


def test_a_wall_starts_held_and_release_is_reported():
    on_a_tether = {"exit.policy": "release", "safety.tethered": True}
    with hil.open_bench("emulated", seed=1, overrides=on_a_tether) as bench:
        assert moved_from(bench, 1.0) < 0.3
    assert bench.held.state == "NOT HELD"
    assert not bench.held.wanted
    assert "released" in bench.held.why


@pytest.mark.parametrize("on_purpose", [True, False])
def test_torque_that_was_switched_off_is_a_loss_unless_the_bench_was_asked(on_purpose):
    with hil.open_bench("emulated", seed=1, overrides={"safety.tethered": True}) as bench:
        wait(bench, 0.2)
        (bench if on_purpose else bench.devices.servos).release()
        wait(bench, 0.5)
    assert (bench.held.state, bench.held.lost) == ("NOT HELD", not on_purpose)
    assert "torque was switched off" in bench.held.why


def test_a_robot_that_was_never_held_is_said_to_be():
    """Nothing presses it on, so that torque stays off: opening the bench reports both."""
    bench = hil.open_bench("emulated", seed=1, faults=["plant:adhesion_loss@0.3"])
    with pytest.raises(SafetyStop, match="not pressed on the wall"), bench:
        raise AssertionError("it opened")
    assert bench.held.state == "NOT HELD"
    assert "torque was never switched on" in bench.held.why


def test_a_robot_that_hangs_by_its_fan_is_not_released():
    with pytest.raises(ConfigError, match=r"exit.policy: 'release' on a wall.*safety.tethered"):
        hil.open_bench("emulated", overrides={"exit.policy": "release"})
    with hil.open_bench("emulated", seed=1) as bench:
        with pytest.raises(UsageError, match=r"hangs on a wall.*safety.tethered = true"):
            bench.release()
        bench.observe(1.0, feedback="odometry")
    assert bench.held.state == "HELD"


def test_with_the_bus_away_the_wheels_rest_within_200_ms():
    at_s = 3.0
    with hil.open_bench("emulated", seed=2, faults=[f"servos:unplug@{at_s}"], overrides=FANLESS) as bench:
        rates = []

        def note(record):
            rates.append(bench.truth().joint_velocity_rad_s[:4].copy())

        with pytest.raises(SafetyStop):
            bench.drive(CLIMB, on_cycle=note)
        assert np.abs(rates[-1]).max() > 0.5
        bench.clock.sleep_until_ns(max(bench.clock.now_ns(), round((at_s + 0.2) * SECOND)))
        assert np.abs(bench.truth().joint_velocity_rad_s[:4]).max() < REST_RAD_S


def test_wheels_that_a_program_forgot_come_to_rest_and_stay_looked_after():
    with hil.open_bench("emulated", seed=1, overrides=FANLESS) as bench:
        steering = np.zeros(4)
        bench.devices.servos.command(hil.core.signals.ServoSetpoint(np.full(4, 1.0), steering))
        wait(bench, 0.05)
        assert bench.truth().joint_velocity_rad_s[:4].min() > 0.3
        wait(bench, 0.25)
        assert np.abs(bench.truth().joint_velocity_rad_s[:4]).max() < 0.02
        assert not bench.devices.servos.look_after().trouble


def test_an_enable_that_fails_is_made_good_when_the_servos_come_back():
    with hil.open_bench("emulated", seed=1, overrides=FANLESS) as bench:
        bench.world.faults.add(parse_fault(f"servos:brownout@{bench.clock.now_ns() / SECOND}+2.5"))
        wait(bench, 0.01)
        with pytest.raises(HilError):
            bench.devices.servos.enable()
        wait(bench, 1.3)
        assert moved_from(bench, 0.5) < 2.0
        assert bench.look().state == "HELD"
