"""HELD in a mix: a sensor of another world than the servos' does not see the robot that they hold."""

import json
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pytest

import hil
from hil.config.bench import BenchConfig
from hil.config.loading import load_bench
from hil.core.clock import MonotonicClock
from hil.core.errors import SafetyStop
from hil.core.registry import kinds
from hil.faults.files import read_faults
from hil.procedure.bench_source import BenchSource
from hil.procedure.declaration import Measurement, Procedure
from hil.procedure.runner import RunOptions, run_procedure
from hil.robot.trajectories import line

pytestmark = pytest.mark.usefixtures("warm_commands")

HOP = line((0, 0, 0), (0.06, 0, 0), duration_s=1.5)
SEES = ("imu", "tracker", "mocap")
PRESSES = ("adhesion", "load_cells")
BRIEFLY = {"exit.look_after_s": 1.0}
"""For a bench whose end is not checked, or which cannot find the robot held."""
REAL_SERVOS = {
    "servos.backend": "real",
    "servos.port": "/dev/no-such-port",
    "environment.start_pose": [0.0, 0.0, 0.0],
}


@contextmanager
def mixed(monkeypatch, *blind, **given):
    """A bench in virtual time, of whose devices these count as those of another world."""
    monkeypatch.setattr(BenchConfig, "elsewhere", lambda self: blind)
    with hil.open_bench("emulated", seed=5, **given) as bench:
        yield bench


@contextmanager
def servos_of_another_process(*options):
    """The overrides by which a bench uses them as real ones; it emulates everything else by itself."""
    command = [sys.executable, "-m", "hil.cli", "emulate", "--only", "servos", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as child:
        try:
            found = json.loads(child.stdout.readline())["servos"]
            yield REAL_SERVOS | {"servos.port": found["port"], "servos.baud": found["baud"]}
        finally:
            child.terminate()


def test_who_is_in_the_servos_world_and_who_is_not():
    emulated = load_bench("emulated")
    assert emulated.elsewhere() == ()
    others = tuple(name for name in emulated.devices() if name != "servos")
    real_servos = load_bench("emulated", overrides=REAL_SERVOS)
    assert real_servos.elsewhere() == others
    assert tuple(real_servos.of_one_world().devices()) == ("servos",)
    real_imu = load_bench("emulated", overrides={"imu.backend": "real", "imu.port": "/dev/no-such-port"})
    assert real_imu.elsewhere() == ("imu",), "a real one does not see an emulated robot either"
    assert load_bench("emulated", overrides={"servos": None, "imu.backend": "real"}).elsewhere() == ()


def test_no_sensor_of_another_world_says_that_the_robot_is_held(monkeypatch):
    with mixed(monkeypatch, *SEES, *PRESSES, overrides=BRIEFLY) as bench:
        pass
    assert bench.held.state == "NOT HELD"
    assert bench.held.moved_m is None
    assert "no sensor can see whether the robot slides (camera, motion capture: " in bench.held.why


def test_who_is_in_the_servos_world_does_without_the_others(monkeypatch):
    with mixed(monkeypatch, "imu", "tracker", "load_cells") as bench:
        assert bench.look().why.startswith("torque on, at rest by servo positions, motion capture; pressed")
        bench.drive(HOP, feedback="odometry", hold_s=0.3)
    assert bench.held.state == "HELD"
    assert bench.held.moved_m < 0.005
    assert "N by the fan's speed" in bench.held.why
    assert not bench.held.confirmed
    assert not [who for who in ("IMU", "camera", "load cells") if who in bench.held.why]


@pytest.mark.parametrize(
    ("blind", "fault"),
    [("load_cells", "load_cells:jump,force_n=20"), ("adhesion", "adhesion:wrong,factor=1.3")],
)
def test_forces_of_two_worlds_are_not_compared(monkeypatch, blind, fault):
    """What contradicts in one world stops the robot, and is another robot's force in the other."""
    faults = read_faults((fault,))
    with (
        pytest.raises(SafetyStop, match="adhesion"),
        mixed(monkeypatch, faults=faults, overrides=BRIEFLY) as bench,
    ):
        bench.drive(HOP, hold_s=0.3)
    with mixed(monkeypatch, blind, faults=faults) as bench:
        motion = bench.drive(HOP, hold_s=0.3)
    assert motion.mocap[-1, 0] == pytest.approx(0.06, abs=0.01)
    assert bench.held.state == "HELD"
    assert not bench.held.confirmed
    (said,) = [one for one in bench.warnings if "force" in one and "another world" in one]
    assert said.startswith(kinds()[blind].noun)
    assert not {"load_cells.zero_n", "adhesion.rated_force_n"} & {*bench.seen.contradicting}


def test_motion_capture_of_another_world_does_not_say_where_the_robot_stands(monkeypatch):
    """It would see the robot of its own world at its start for ever."""
    with mixed(monkeypatch, "mocap", start_pose=(0.1, 0.0, 0.0), overrides=BRIEFLY) as bench:
        np.testing.assert_array_equal(bench.measured_pose(np.ones((5, 3))), (0.1, 0.0, 0.0))
        way = line((0.1, 0, 0), (0.16, 0, 0), duration_s=1.5)
        end = bench.drive(way, feedback="odometry", hold_s=0.3).estimate[-1]
        np.testing.assert_allclose(bench.settle(), end, atol=1e-3)
        back = line((0.16, 0, 0), (0.1, 0, 0), duration_s=1.5)
        begun = bench.drive(back, feedback="odometry", hold_s=0.3).estimate[0]
        np.testing.assert_allclose(begun, end, atol=2e-3)


def test_a_drive_past_blind_sensors_is_reported_before_it_moves(monkeypatch, tmp_path, caplog):
    def body(ctx):
        ctx.bench.observe(0.1)
        assert "in another world" not in caplog.text, "nothing moves yet"
        for k in range(2):
            ctx.bench.drive(line((0.02 * k, 0, 0), (0.02 * (k + 1), 0, 0), duration_s=0.8), hold_s=0.1)
        ctx.measure("x", 0.0)

    monkeypatch.setattr(BenchConfig, "elsewhere", lambda self: ("tracker", "load_cells"))
    proc = Procedure(
        name="past", body=body, summary="", needs=("servos",), measurements=(Measurement("x", "m"),)
    )
    options = RunOptions(
        folder=tmp_path / "o", clock=MonotonicClock(), started="2025-01-01T00:00:00", parameters={}
    )
    result = run_procedure(proc, BenchSource("emulated", overrides=BRIEFLY), options)
    said = "camera: in another world than the servos"
    assert sum(said in record.getMessage() for record in caplog.records) == 1, "once, and of no load cells"
    assert sum(row["what"].startswith(said) for row in result.facts["events"]) == 1


def test_real_servos_beside_emulated_sensors_are_not_held_by_them():
    """Another process has the robot; it falls off its wall, which no sensor of ours can see."""
    with (
        servos_of_another_process("--fault", "plant:adhesion_loss@2") as overrides,
        hil.open_bench("emulated", overrides=overrides) as bench,
    ):
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 2_000_000_000)
    assert bench.held.state == "NOT HELD"
    assert "at rest by" not in bench.held.why


@pytest.mark.long
def test_an_emulated_camera_stops_the_drive_of_real_servos():
    """It rests while the wheels roll: so the mix that the examples once showed could not pass."""
    with servos_of_another_process() as overrides, hil.open_bench("emulated", overrides=overrides) as bench:
        with pytest.raises(SafetyStop) as stop:
            bench.drive(line((0, 0, 0), (0.12, 0, 0), duration_s=2.4))
        assert stop.value.reason == "sensors_disagree"
        reported = ("fan, propellers: emulated beside real", "IMU, camera, motion capture: in another world")
        assert all(said.startswith(start) for said, start in zip(bench.warnings, reported, strict=True))


def test_what_is_emulated_of_that_which_holds_a_real_robot_is_known():
    assert load_bench("emulated").emulated_holders() == ()
    real = load_bench("emulated", overrides=REAL_SERVOS)
    assert real.emulated_holders() == ("adhesion", "thrust")
    assert load_bench("emulated", overrides={**REAL_SERVOS, "adhesion": None}).emulated_holders() == (
        "thrust",
    )
    nothing_hangs = load_bench("emulated", overrides={"adhesion.backend": "real"})
    assert nothing_hangs.emulated_holders() == (), "these servos are emulated: nothing real hangs by them"


@contextmanager
def pretended(monkeypatch, *holders, blind=(), **given):
    """A bench in virtual time, with these counted as emulated beside real servos."""
    monkeypatch.setattr(BenchConfig, "emulated_holders", lambda self: holders)
    with mixed(monkeypatch, *holders, *blind, **given) as bench:
        yield bench


def test_a_robot_whose_fan_is_emulated_is_not_held_whichever_sensor_sees_it_at_rest(monkeypatch, caplog):
    with pretended(monkeypatch, "adhesion", blind=["load_cells"], overrides=BRIEFLY) as bench:
        bench.observe(0.2)
        bench.observe(0.2)
    assert bench.held.state == "NOT HELD"
    assert "nothing real reports what presses the robot on the wall (fan: emulated" in bench.held.why
    said = "fan: emulated beside real servos, so the real robot gets nothing from there that holds it"
    assert sum(said in record.getMessage() for record in caplog.records) == 1
    assert [warning for warning in bench.warnings if warning.startswith(said)]


def test_real_load_cells_say_what_presses_a_robot_whose_fan_is_emulated(monkeypatch):
    with pretended(monkeypatch, "adhesion") as bench:
        assert bench.look().state == "HELD"
    assert "N by the load cells" in bench.held.why


def test_emulated_propellers_carry_nothing_of_a_real_robot(monkeypatch):
    with pretended(monkeypatch, "thrust", overrides=BRIEFLY) as bench:
        pass
    assert bench.held.state == "NOT HELD"
    assert "are needed without the propellers: they are emulated beside real servos" in bench.held.why


@pytest.mark.parametrize("changed", [{"safety.tethered": True}, {"adhesion": None, "load_cells": None}])
def test_on_a_tether_or_held_by_something_else_the_rule_is_as_it_was(monkeypatch, changed):
    holders = ("adhesion",) if "adhesion" not in changed else ()
    with pretended(monkeypatch, *holders, blind=["load_cells"], overrides=changed) as bench:
        bench.observe(0.2)
    assert bench.held.state == "HELD"
    assert not any("holds it on its wall" in warning for warning in bench.warnings)
