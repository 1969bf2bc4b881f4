"""HELD is not said of a robot whose fan may be dying: it stands still until the fan has run down."""

from contextlib import suppress

import numpy as np
import pytest

import hil
from hil.bench.hold.adhesion_force import RUN_DOWN_S
from hil.core.errors import SafetyStop
from hil.robot.trajectories import line

CLIMB = line((0, 0, 0), (0.12, 0, 0), duration_s=4.0)
BRIEFLY = {"exit.look_after_s": 1.0, "loop.rate_hz": 50.0}
"""For a bench whose end is not checked, at half the usual rate."""


def left(fault, **overrides):
    """How a climb that the fault ended left the robot, how long the look took, and how far the robot went."""
    with hil.open_bench("emulated", seed=1, faults=[fault], overrides={**BRIEFLY, **overrides}) as bench:
        with pytest.raises(SafetyStop):
            bench.drive(CLIMB, feedback="odometry")
        stopped = bench.truth().pose_body_in_wall
        began_ns = bench.clock.now_ns()
        held = bench.look(10.0)
        took_s = (bench.clock.now_ns() - began_ns) / 1e9
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 1_000_000_000)
        went_m = float(np.hypot(*(bench.truth().pose_body_in_wall - stopped)[:2]))
    return held, took_s, went_m


@pytest.mark.parametrize("start_s", [0.05, pytest.param(1.0, marks=pytest.mark.long)])
def test_a_fan_off_its_bus_is_never_held_before_it_has_run_down(start_s):
    held, _, went_m = left(f"adhesion:bus_off@{start_s}")
    assert went_m > 0.1
    assert held.state == "NOT HELD"


@pytest.mark.parametrize("reset_s", [1.31, *(pytest.param(s, marks=pytest.mark.long) for s in (1.25, 1.37))])
def test_a_fan_that_runs_down_during_the_hold_check_is_not_held(reset_s):
    """The last estimate before the stop is NaN; what is needed must not become NaN with it."""
    faults = ["servos:unplug@1+0.2", f"adhesion:reset@{reset_s}"]
    with hil.open_bench("emulated", seed=1, faults=faults, overrides=BRIEFLY) as bench:
        with pytest.raises(SafetyStop):
            bench.drive(CLIMB, feedback="odometry")
        held = bench.look(0.35)
        assert bench.truth().adhesion_n < 40.0
    assert held.state == "NOT HELD"
    assert "falls by" in held.why or "are needed" in held.why


def test_a_fan_that_runs_on_unheard_is_held_by_what_the_cells_feel_for_long_enough():
    held, took_s, went_m = left("adhesion:garbage@1")
    assert went_m < 2e-3
    assert held.state == "HELD"
    assert took_s > RUN_DOWN_S + 1.0


def test_a_fan_without_reports_and_load_cells_is_not_held():
    held, _, _ = left("adhesion:garbage@1", load_cells=None)
    assert held.state == "NOT HELD"
    assert "no sensor measures it" in held.why


def test_a_tether_holds_what_no_fan_presses():
    held, took_s, _ = left("servos:unplug@1+0.5", **{"safety.tethered": True})
    assert held.state == "HELD"
    assert took_s < RUN_DOWN_S


DEAF = ["thrust:garbage@1.3", "thrust:baud_mismatch@1.3"]
SHORT = line((0, 0, 0), (0.06, 0, 0), duration_s=1.5)


def place(bench):
    return bench.truth().pose_body_in_wall[:2].copy()


@pytest.mark.parametrize(
    ("fault", "plant"),
    [
        (DEAF[0], "own"),
        *(pytest.param(fault, "own", marks=pytest.mark.long) for fault in DEAF[1:]),
        *(pytest.param(fault, "mujoco", marks=pytest.mark.long) for fault in DEAF),
    ],
)
def test_propellers_that_do_not_understand_their_commands_are_no_ground_for_held(fault, plant):
    """They take their throttle down step by step: the robot rests for seconds before it slides."""
    if plant == "mujoco":
        pytest.importorskip("mujoco")
    bench = hil.open_bench("emulated", seed=1, faults=[fault], overrides={"emulation.plant": plant})
    with bench, suppress(SafetyStop):
        bench.drive(SHORT)
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 5_000_000_000)
    assert bench.truth().fallen
    assert bench.held.state == "NOT HELD"


@pytest.mark.long
def test_a_bench_that_goes_on_does_not_take_them_for_a_ground_either():
    with hil.open_bench("emulated", seed=1, faults=["thrust:garbage@1.3"]) as bench:
        bench.drive(SHORT)
        assert bench.look().state == "NOT HELD"


@pytest.mark.long
def test_wheels_that_turn_more_than_a_sliding_robot_goes_are_not_suspected_alone():
    events = []
    bench = hil.open_bench("emulated", seed=0, faults=["thrust:wrong@1.3"])
    with bench, pytest.raises(SafetyStop) as stop:
        bench.drive(CLIMB, on_cycle=lambda record: events.extend(record.events))
    suspected = [event.suspects for event in events if "servos" in event.suspects]
    assert suspected
    assert all("thrust" in names for names in (*suspected, stop.value.suspects))


@pytest.fixture(scope="module")
def ended_s():
    """When a bench that climbed begins to close, and says that its robot is held: seconds of the world."""
    with hil.open_bench("emulated", seed=1) as bench:
        bench.drive(SHORT)
        closing_s = bench.clock.now_ns() / 1e9
    assert bench.held.state == "HELD"
    return closing_s, bench.looked_ns / 1e9


def left_for_good(fault):
    """What a closing bench says of its robot, and how far that goes in the 5 s after it."""
    bench = hil.open_bench("emulated", seed=1, faults=[fault])
    with bench:
        bench.drive(SHORT)
    stood = place(bench)
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 5_000_000_000)
    return bench.held, float(np.linalg.norm(place(bench) - stood))


def test_what_a_closing_bench_calls_held_goes_on_without_a_line_to_the_propellers(ended_s):
    """No line is sent while it looks, so none can be misunderstood."""
    held, went_m = left_for_good(f"thrust:garbage@{ended_s[0] + 0.8:.3f}")
    assert held.state == "HELD"
    assert went_m < 5e-4


def test_a_force_that_falls_slowly_is_no_ground_for_held(ended_s):
    """It falls further than a fan that is raised meanwhile can make up for."""
    held, went_m = left_for_good(f"plant:adhesion_loss@{ended_s[1] - 1.5:.3f},factor=0.1,over_s=6")
    assert went_m > 0.01
    assert held.state == "NOT HELD"


def test_servos_that_restart_at_the_end_of_the_look_are_waited_for(ended_s):
    held, went_m = left_for_good(f"servos:off@{ended_s[1] - 0.2:.3f}+0.4")
    assert held.state == "HELD"
    assert went_m < 5e-4
