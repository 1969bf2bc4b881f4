"""What one session measured and the next finds otherwise is named: at rest, where rest shows it."""

import math
import re

import pytest

from hil.bench import open_bench
from hil.bench.doctor.examination import examine
from hil.config.loading import load_bench
from hil.config.robot_record import Figure, NewPart, Part, RobotRecord
from hil.config.robot_record.overlay import identity
from hil.core.errors import ConfigError, SafetyStop
from hil.core.geometry import quat_from_yaw
from hil.procedure.sample_arrays import inertial, poses
from hil.robot.trajectories import line
from tests.patience import FANLESS

SEED = 5
WAY = line((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))


def keep(folder, bias_deg_s, turned_rad):
    """The record of a session that found this bias, and this rotation of the mount."""
    part = Part(
        procedure="imu_calibration",
        verdict="PASS",
        measured="2026-01-01T00:00:00",
        bench="emulated",
        values={"imu.mount_rotation_wxyz": list(quat_from_yaw(turned_rad))},
        figures={"gyro_bias": Figure(value=bias_deg_s, unit="deg/s")},
    )
    whose = identity(load_bench("emulated", overrides=FANLESS), SEED)
    RobotRecord(folder).add({"inertial": NewPart(part)}, whose, created=part.measured, why="imu_calibration")
    return {**FANLESS, "record.folder": str(folder)}


@pytest.fixture(scope="module")
def found():
    """Bias (deg/s) and heading of gravity less that of motion capture (rad) of the robot as it is."""
    with open_bench("emulated", seed=SEED, overrides=FANLESS) as bench:
        rest = bench.observe(1.0, feedback="odometry")
    imu, truth = inertial(rest), poses(rest, "mocap")
    return math.degrees(imu.mean(0)), imu.mean(1) - truth.mean(2)


@pytest.fixture
def kept(tmp_path, found):
    return keep(tmp_path / "robot", *found)


def turned(kept, angle_rad):
    """The same robot, its IMU turned by so much since."""
    return {**kept, "emulation.imu.mount_rotation_wxyz": list(quat_from_yaw(angle_rad))}


@pytest.mark.parametrize(("angle_rad", "level"), [(0.0, "ok"), (-0.05, "warning")])
def test_the_doctor_names_an_imu_that_has_turned(kept, angle_rad, level):
    bench = open_bench("emulated", seed=SEED, overrides=turned(kept, angle_rad))
    by_check = {f.check: f.level for f in examine(bench, watch_s=0.5)}
    assert by_check["heading against motion capture"] == level
    assert by_check["gyro bias"] == "ok"


def drive(overrides, feedback):
    with open_bench("emulated", seed=SEED, overrides=overrides) as bench:
        motion = bench.drive(WAY, hold_s=0.1, feedback=feedback)
        return bench.warnings, motion


def number_before(unit, said):
    return float(re.search(rf"([-+.\d]+){unit}", said)[1])


@pytest.mark.parametrize("feedback", ["ekf", pytest.param("odometry", marks=pytest.mark.long)])
def test_a_robot_that_is_to_move_says_so(kept, feedback):
    assert drive(turned(kept, 0.0), feedback)[0] == []
    (said,) = drive(turned(kept, 0.05), feedback)[0]
    assert abs(number_before(" rad", said)) == pytest.approx(0.05, abs=0.01)


def test_no_filter_is_given_an_imu_that_has_turned_by_far(kept, found):
    overrides = turned(kept, 0.2)
    with open_bench("emulated", seed=SEED, overrides=overrides) as bench:
        with pytest.raises(ConfigError, match=r"imu\.mount_rotation_wxyz.*nothing is moved"):
            bench.drive(WAY, hold_s=0.1)
        assert math.hypot(*bench.truth().pose_body_in_wall[:2]) < 0.005
    _, motion = drive(overrides, "odometry")
    assert motion.mocap[-1][0] == pytest.approx(0.1, abs=0.01)


def test_a_gyro_that_has_drifted_is_named(tmp_path, found):
    bias_deg_s, turned_rad = found
    drifted = keep(tmp_path / "robot", bias_deg_s + 0.5, turned_rad)
    (said,) = drive(drifted, "ekf")[0]
    assert number_before(" deg/s", said) == pytest.approx(-0.5, abs=0.05)


def test_nothing_is_said_where_nothing_is_kept():
    bench = open_bench("emulated", seed=SEED, overrides=turned({}, 0.2))
    checks = [f.check for f in examine(bench, watch_s=0.5)]
    assert not {"gyro bias", "heading against motion capture"} & set(checks)


JUMPED = {-6.0: True, 1.0: False}


@pytest.mark.parametrize(("force_n", "named"), JUMPED.items())
def test_the_zero_of_the_cells_is_held_against_the_fan(force_n, named):
    faults = f"load_cells:jump@0,force_n={force_n}"
    examined = open_bench("emulated", seed=SEED, faults=faults)
    failed = [f.found for f in examine(examined, watch_s=0.5) if f.level == "failure"]
    states = {row.key: row.state for row in examined.parameters.rows()}
    assert states["load_cells.zero_n"] == ("contradicted" if named else "unconfirmed")
    assert any("load_cells.zero_n" in text for text in failed) is named
    bench = open_bench("emulated", seed=SEED, faults=faults)
    if not named:
        with bench:
            return
    with pytest.raises(SafetyStop, match="nothing has moved") as stop, bench:
        pass
    assert stop.value.reason == "adhesion_disagree"


@pytest.mark.parametrize(("scale", "named"), [(1.0, False), (1.05, True)])
def test_a_drive_reports_a_camera_with_another_scale_than_the_kept_one(scale, named):
    kept = {"tracker.scale": scale, "tracker.scale_sigma": 0.002, "emulation.tracker.scale_sigma": 0.0}
    with open_bench("emulated", seed=SEED, overrides={**FANLESS, **kept}) as bench:
        records = bench.drive(line((0.0, 0.0, 0.0), (0.3, 0.0, 0.0)), hold_s=0.1).records
    said = [e.message for r in records for e in r.events if "camera" in e.message]
    assert bool(said) is named
