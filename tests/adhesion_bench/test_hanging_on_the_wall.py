"""A robot that hangs by its fan: how it is pressed on the wall, what stops it, and with how much left."""

import math
import re

import numpy as np
import pytest

import hil
from hil.bench.hold.preload import Preload
from hil.bench.loop_settings import adhesion_limits, thrust_wanted_n
from hil.core.errors import DeviceError, SafetyStop, UsageError
from hil.fault_matrix import cells_of
from hil.fault_matrix.drive import run_cell
from hil.procedure.tracking_errors import enable_hold
from hil.robot.trajectories import line

CLIMB = line((0, 0, 0), (0.12, 0, 0), duration_s=4.0)
COLD = {"emulation.adhesion.start": "tethered", "emulation.thrust.start": "tethered"}
BRIEFLY = {"exit.look_after_s": 1.0, "loop.rate_hz": 50.0}
"""For a bench whose end is not checked, at half the usual rate."""
AT_REST_RAD_S = 0.05


def climb(*faults, seed=1, overrides=None, feedback="odometry"):
    """Climb until something stops the robot: the stop, and (time, force, fastest wheel) of every cycle."""
    seen, stop, overrides = [], None, {**BRIEFLY, **(overrides or {})}
    with hil.open_bench("emulated", seed=seed, faults=faults, overrides=overrides) as bench:
        try:
            bench.drive(CLIMB, feedback=feedback, on_cycle=lambda record: seen.append(look(bench)))
        except SafetyStop as error:
            stop = error
            for _ in range(60):
                seen.append(look(bench))
                bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
        truth = bench.truth()
    return stop, seen, truth


def look(bench):
    truth = bench.truth()
    return truth.t_ns / 1e9, truth.adhesion_n, float(np.abs(truth.joint_velocity_rad_s[:4]).max())


def true_need_n(bench_seed):
    """Force at which this world's robot slides: closed form with its own parameters."""
    with hil.open_bench("emulated", seed=bench_seed, overrides=BRIEFLY) as bench:
        p = bench.world.plant.parameters
        return (p.mass_kg * 9.81 - p.thrust_n) / p.contact.friction


def force_when_at_rest(seen, since_s):
    """Force when the wheels had come to rest after the fault."""
    return next(force for t_s, force, rate in seen if t_s > since_s + 0.05 and rate < AT_REST_RAD_S)


@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.long) for s in range(2, 21))])
def test_falling_adhesion_stops_the_wheels_with_a_fifth_of_the_margin_left(seed):
    """Force falls along a line to nothing within 2 s, whatever the fan does: a seal that goes."""
    stop, seen, _ = climb("plant:adhesion_loss@2,factor=0,over_s=2", seed=seed)
    needed_n, whole_n = true_need_n(seed), seen[0][1]
    assert stop is not None
    assert stop.reason in ("adhesion", "utilisation")
    assert "s are left" in str(stop)
    reported = re.search(r"N of margin left \((\d+) %\)", str(stop))
    assert reported is not None
    assert 20 <= int(reported[1]) <= 90
    margin = (force_when_at_rest(seen, 2.0) - needed_n) / (whole_n - needed_n)
    assert margin >= 0.2


def test_a_fan_that_loses_its_power_stops_the_robot_with_the_time_that_is_left():
    stop, seen, _ = climb("adhesion:adhesion_loss@2,factor=0,over_s=2")
    assert stop is not None
    assert stop.reason in ("adhesion", "utilisation", "adhesion_disagree")
    assert force_when_at_rest(seen, 2.0) > 26.0


@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.long) for s in range(2, 21))])
def test_a_robot_falls_only_where_the_fan_really_fails(seed):
    """What is lost of the force stops the wheels; what is left of it holds the robot."""
    stop, seen, truth = climb("plant:adhesion_loss@2,factor=0.6,over_s=1", seed=seed)
    assert stop is not None
    assert seen[-1][2] < AT_REST_RAD_S
    assert not truth.fallen


def test_a_force_that_stays_over_its_limit_and_a_little_drift_of_the_cells_stop_nothing():
    drift = {"emulation.load_cells.drift_n_per_min": 0.1}
    stop, _, truth = climb("plant:adhesion_loss@1,factor=0.93,over_s=2", overrides=drift)
    assert stop is None
    assert not truth.fallen


@pytest.mark.parametrize(
    ("spec", "reasons", "reported"),
    [
        ("load_cells:jump@2,force_n=12", ("adhesion_disagree",), "the cells are wrong"),
        ("load_cells:jump@2,force_n=-30", ("adhesion",), "N of adhesion by the load cells (4"),
        ("load_cells:wrong@1,drift_n_s=4", ("adhesion_disagree",), "the cells are wrong"),
        ("load_cells:stuck@2", ("stale_load_cells",), "nothing usable from the load cells"),
        ("adhesion:slow@2,factor=50", ("stale_adhesion",), "nothing usable from the fan's controller"),
        ("adhesion:stuck@2", ("stale_adhesion",), "nothing usable from the fan's controller"),
        ("adhesion:wrong@2,factor=1.3", ("adhesion_disagree",), "the reported speed is wrong"),
    ],
)
def test_who_lies_about_the_force_is_found_against_the_others(spec, reasons, reported):
    stop, seen, truth = climb(spec)
    assert stop is not None
    assert stop.reason in reasons
    assert reported in str(stop)
    assert seen[-1][2] < AT_REST_RAD_S
    assert not truth.fallen


@pytest.mark.parametrize(
    ("overrides", "reason", "reported"),
    [
        (
            {"emulation.adhesion.ambient_c": 60.0},
            "fan_hot",
            r"at 8\d degC, more than 80.*N of margin left \(\d+ %\)",
        ),
        (
            {"adhesion.low_input_v": 23.0},
            "battery_low",
            r"has 22.\d V under load.*N of margin left \(\d+ %\)",
        ),
    ],
)
def test_a_hot_controller_and_a_low_battery_stop_the_robot(overrides, reason, reported):
    stop, _, _ = climb(overrides=overrides)
    assert stop.reason == reason
    assert re.search(reported, str(stop))


def test_a_bus_that_is_gone_stops_the_robot_and_says_what_the_time_out_does():
    with hil.open_bench("emulated", seed=1, faults=["adhesion:unplug@2"], overrides=BRIEFLY) as bench:
        with pytest.raises((SafetyStop, DeviceError), match=r"fan's controller|lets go of the motor"):
            bench.drive(CLIMB)
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 300_000_000)
        assert np.abs(bench.truth().joint_velocity_rad_s[:4]).max() < AT_REST_RAD_S


def test_the_fan_is_started_and_waited_for_before_torque_comes_on():
    with hil.open_bench("emulated", seed=1, overrides=COLD) as bench:
        assert bench.world.plant.by_hand is False, "the servos have torque now"
        assert 1.0 < bench.clock.now_ns() / 1e9 < 8.0
        needed_n = adhesion_limits(bench.config).limit_n(thrust_wanted_n(bench.config), 0.0)
        assert bench.truth().adhesion_n > needed_n
        motion = bench.drive(line((0, 0, 0), (0.03, 0, 0), duration_s=1.5))
        assert not bench.truth().fallen
    assert motion.records[-1].state.diagnostics["adhesion_margin_n"] > 15.0
    assert bench.held.state == "HELD"


@pytest.mark.parametrize(
    "fault",
    ["adhesion:adhesion_loss@0,factor=0.3", "plant:adhesion_loss@0,factor=0.4", "adhesion:bus_off@0.6"],
)
def test_no_torque_and_no_motion_before_the_force_is_there(fault):
    bench = hil.open_bench("emulated", seed=1, overrides=COLD, faults=[fault])
    with pytest.raises((SafetyStop, DeviceError)) as caught:
        bench.__enter__()
    reported = str(caught.value)
    assert "N are the least on this surface" in reported or "adhesion" in reported
    assert bench.world.plant.by_hand, "the servos got no torque"


def test_the_state_carries_force_margin_and_what_each_wheel_uses():
    with hil.open_bench("emulated", seed=1, overrides=BRIEFLY) as bench:
        motion = bench.drive(line((0, 0, 0), (0.03, 0, 0), duration_s=1.5))
        truth = bench.truth()
    figures = motion.records[-1].state.diagnostics
    assert figures["adhesion_n"] == pytest.approx(truth.adhesion_n, rel=0.03)
    assert figures["adhesion_needed_n"] == pytest.approx(0.3 * 3.25 * 9.81 / 0.45, rel=0.01)
    used = [figures[f"utilisation_{w}"] for w in ("FL", "BL", "BR", "FR")]
    assert 0.35 < min(used) < max(used) < 0.65


def test_too_much_friction_in_use_stops_the_robot_before_it_slides():
    tight = {"safety.utilisation_limit": 0.6, "safety.adhesion_reserve": 0.1}
    stop, _, truth = climb("plant:adhesion_loss@2,factor=0.85", overrides=tight)
    assert stop.reason == "utilisation"
    assert "of its friction" in str(stop)
    assert not truth.fallen


def test_the_end_of_a_run_leaves_the_fan_running():
    with hil.open_bench("emulated", seed=1, overrides=BRIEFLY) as bench:
        bench.observe(0.5, feedback="odometry")
        world = bench.world
    world.advance_to(world.now_ns + 5_000_000_000)
    assert world.plant.truth().adhesion_n > 40.0
    assert not world.plant.truth().fallen


def test_on_the_floor_nothing_waits_for_a_fan():
    floor = {"environment.surface": "floor", "environment.tilt_rad": 0.0, **COLD}
    with hil.open_bench("emulated", seed=1, overrides=floor) as bench:
        start = enable_hold(bench)  # propellers have pushed it along the floor before its servos had torque
        motion = bench.drive(line(start, start + np.array([0.03, 0, 0]), duration_s=1.5))
    assert math.isfinite(motion.records[-1].state.pose_body_in_wall[0])


@pytest.mark.long
def test_the_force_follows_the_need_with_a_margin_and_spares_the_battery():
    watts = {}
    for by_need in (False, True):
        with hil.open_bench("emulated", seed=1, overrides={"adhesion.by_need": by_need}) as bench:
            motion = bench.observe(16.0, feedback="odometry")
            limit_n = adhesion_limits(bench.config).limit_n(thrust_wanted_n(bench.config), 0.0)
        newest = [s for r in motion.records[-100:] for s in r.inputs.adhesion]
        watts[by_need] = np.mean([s.input_a * s.input_v for s in newest])
        force_n = motion.records[-1].state.diagnostics["adhesion_n"]
    assert limit_n < force_n < 1.25 * limit_n
    assert watts[True] < 0.7 * watts[False]


def test_cells_and_speed_that_disagree_before_the_start_leave_the_servos_without_torque():
    bench = hil.open_bench("emulated", seed=1, faults=["load_cells:wrong@0,factor=1.4"])
    with pytest.raises(SafetyStop, match="by the fan's speed") as caught:
        bench.__enter__()
    assert caught.value.reason == "adhesion_disagree"
    assert bench.world.plant.by_hand


def test_cells_that_are_not_there_are_named_and_nothing_is_switched():
    overrides = {"load_cells.model": "hx711_line", **COLD}
    bench = hil.open_bench("emulated", seed=1, overrides=overrides, faults=["load_cells:off@0"])
    with pytest.raises(DeviceError, match=r"load_cells at .*no conversion for 1.0 s.*supply") as caught:
        bench.__enter__()
    assert caught.value.exit_code == 3
    assert bench.world.plant.by_hand, "the servos got no torque"


def test_a_negative_push_is_refused_and_the_propellers_go_on():
    with hil.open_bench("emulated", seed=1, overrides=BRIEFLY) as bench:
        with pytest.raises(UsageError, match=r"thrust: a force of -3 N.*0 to 39.7 N"):
            bench.devices.get("thrust").set_force_n(-3.0)
        bench.observe(0.5, feedback="odometry")
        assert bench.truth().thrust_n > 15.0


@pytest.mark.long
def test_an_estimate_that_motion_capture_contradicts_while_it_slides_points_at_what_holds_it():
    """In this world the slide is found by the estimate alone, slower than any other check sees."""
    pytest.importorskip("mujoco", reason="the extra mujoco is not installed")
    (cell,) = cells_of({"thrust": {"off": ()}}, seeds=(4,), plants=("mujoco",), moments=("stop",))
    verdict = run_cell(cell)
    assert verdict.why == ()
    assert verdict.ended == "sensors_disagree"


def wait(bench, seconds):
    bench.clock.sleep_until_ns(bench.clock.now_ns() + round(seconds * 1e9))


def least_force_n(bench, seconds):
    """The least that presses it while it is watched."""
    seen = []
    bench.observe(seconds, feedback="odometry", on_cycle=lambda record: seen.append(bench.truth().adhesion_n))
    return min(seen)


@pytest.mark.parametrize("model", ["vesc", pytest.param("dronecan", marks=pytest.mark.long)])
def test_a_session_after_a_stop_that_raised_the_fan_leaves_it_so_and_is_not_ended(model, monkeypatch):
    """What is opened next does the same to a fan that runs as this: it asks for the working force."""
    limit = {"safety.utilisation_limit": 0.65, "adhesion.model": model}
    with hil.open_bench("emulated", seed=1, overrides=limit) as bench:
        monkeypatch.setattr(bench, "check", lambda trajectory: None)  # it would refuse this turn
        with pytest.raises(SafetyStop) as stop:
            bench.drive(line((0, 0, 0), (0, 0, 0.24), duration_s=4.0), feedback="odometry")
        assert stop.value.reason == "utilisation"
        assert "the fan is raised now, and the next session leaves it so" in str(stop.value)
        assert "`hil adhesion on --tethered` lowers the force" in str(stop.value)
        wait(bench, 3.0)
        raised_n = bench.truth().adhesion_n
        assert raised_n > 49.0
        reported = Preload(bench.config, bench.devices, bench.clock).hold()
        assert re.search(
            r"The fan ran at 5\d\.\d N, more than the 45 N of the bench's file, .*, and stays there", reported
        )
        assert least_force_n(bench, 2.0) > raised_n - 1.0
    assert bench.held.state == "HELD"


def test_a_fan_that_runs_as_the_bench_wants_is_asked_for_that(monkeypatch):
    """Not for what it happens to give: that would creep up from session to session."""
    with hil.open_bench("emulated", seed=1, overrides=BRIEFLY) as bench:
        bench.devices.get("adhesion").set_force_n(45.4)
        wait(bench, 2.0)
        asked = []
        monkeypatch.setattr(bench.devices.get("adhesion"), "set_force_n", asked.append)
        assert "stays there" not in Preload(bench.config, bench.devices, bench.clock).hold()
        assert asked == [45.0]


def test_by_need_goes_down_from_a_raised_force_in_small_steps():
    with hil.open_bench("emulated", seed=1, overrides={"adhesion.by_need": True, **BRIEFLY}) as bench:
        bench.devices.brace()
        wait(bench, 3.0)
        raised_n = bench.truth().adhesion_n
        seen = []
        bench.observe(3.0, on_cycle=lambda record: seen.append(bench.truth().adhesion_n))
        assert raised_n > 49.0
        assert raised_n - 6.0 < seen[-1] < raised_n - 1.0
