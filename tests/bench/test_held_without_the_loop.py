"""After the stop no loop runs: propellers and servos that restart then get their commands again anyway."""

import numpy as np
import pytest

import hil
from hil.core.clock import nanoseconds
from hil.core.errors import SafetyStop
from hil.fakes.servos.dynamixel.chip import ServoBus
from hil.robot.trajectories import line

WAY = line((0.0, 0.0, 0.0), (0.12, 0.0, 0.0), duration_s=3.0)
SHORT = line((0.0, 0.0, 0.0), (0.04, 0.0, 0.0), duration_s=1.2)
ENDED_S = 2.7


def place(bench):
    return bench.truth().pose_body_in_wall[:2].copy()


RESET, BROWNOUT = "thrust:reset@{}", "thrust:brownout@{}+0.05"


@pytest.mark.parametrize(
    ("fault", "after_s", "looks"),
    [
        (RESET, 0.1, True),
        (BROWNOUT, 1.0, False),
        pytest.param(RESET, 1.0, False, marks=pytest.mark.long),
        pytest.param(BROWNOUT, 0.1, True, marks=pytest.mark.long),
    ],
)
def test_propellers_that_restart_after_the_stop_push_again(fault, after_s, looks):
    with hil.open_bench("emulated", seed=1, faults=[fault.format(ENDED_S + after_s)]) as bench:
        bench.drive(SHORT, hold_s=0.5)
        stood = place(bench)
        for _ in range(3):
            if looks:
                bench.look()
            bench.clock.sleep_until_ns(bench.clock.now_ns() + nanoseconds(1.0))
        assert not bench.truth().fallen
        assert np.linalg.norm(place(bench) - stood) < 0.005
        held = bench.look()
    assert held.state == "HELD"


LATE = "servos:slow@{},answer_s=0.02"


SAG_M_S = 0.024
"""How fast the robot slides while its servos have no torque (docs/reliability.md)."""


@pytest.mark.parametrize(
    ("faults", "outage_s"),
    [
        pytest.param([LATE.format(2), "servos:brownout@2.15+0.05"], 0.05, marks=pytest.mark.long),
        ([LATE.format(2), "servos:brownout@2.15+0.3"], 0.3),
        pytest.param([LATE.format(2.6), "servos:brownout@2.15+0.3"], 0.3, marks=pytest.mark.long),
        (["servos:corrupt@2,probability=0.8", "servos:brownout@2.3+0.1"], 0.1),
    ],
)
@pytest.mark.parametrize("plant", ["own", pytest.param("mujoco", marks=pytest.mark.long)])
def test_servos_that_hear_and_are_not_heard_have_their_torque_back(faults, outage_s, plant):
    """Supply and bus are there again, answers are late or lost: 28 to 61 mm of sliding before."""
    if plant == "mujoco":
        pytest.importorskip("mujoco", reason="the extra mujoco is not installed")
    over = {"emulation.plant": plant}
    with hil.open_bench("emulated", seed=1, faults=faults, overrides=over) as bench:
        with pytest.raises(SafetyStop, match="stale_servos"):
            bench.drive(WAY)
        stood = place(bench)
        for _ in range(3):
            bench.look()
        assert np.linalg.norm(place(bench) - stood) < max(0.005, SAG_M_S * outage_s)


def test_released_servos_that_are_not_heard_stay_released():
    with hil.open_bench("emulated_floor", seed=1, faults=["servos:slow@2.5,answer_s=0.02"]) as bench:
        bench.drive(line((0.0, 0.0, 0.0), (0.02, 0.0, 0.0), duration_s=1.0), hold_s=0.2)
        bench.release()
        bench.clock.sleep_until_ns(nanoseconds(3.0))
        for _ in range(3):
            assert bench.look().state == "not needed"
        bus = next(part for part in bench.world._parts if isinstance(part, ServoBus))
        assert not any(servo.torque for servo in bus.servos)


def test_a_port_of_the_propellers_that_takes_nothing_is_reported_once(caplog):
    with hil.open_bench("emulated", seed=1, faults=[f"thrust:unplug@{ENDED_S + 0.2}"]) as bench:
        bench.drive(SHORT, hold_s=0.5)
        bench.clock.sleep_until_ns(bench.clock.now_ns() + nanoseconds(3.0))
        assert not bench.truth().fallen
    reported = [r.getMessage() for r in caplog.records if "while no caller read" in r.getMessage()]
    assert len(reported) == 1
    assert "the propellers go on as last commanded" in reported[0]
