"""An encoder or a horn that slipped while no program ran is named by doctor and when the robot is to move."""

import json

import pytest

from hil.bench import open_bench
from hil.bench.doctor.examination import examine
from hil.bench.doctor.steering_offsets import encoder_minus_servo
from hil.cli import main
from hil.config.robot_record import RobotRecord
from hil.core.errors import SafetyStop
from hil.robot.trajectories import line

WAY = line((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))


def at_rest(**options):
    with open_bench("emulated_floor", seed=5, **options) as bench:
        records = bench.observe(0.3, feedback="odometry").records
    return encoder_minus_servo(
        bench.config,
        [s for r in records for s in r.inputs.encoders],
        [s for r in records for s in r.inputs.servos],
    )


@pytest.fixture(scope="module")
def kept():
    """As an earlier session measured it."""
    return {"encoders.minus_servo_rad": list(at_rest())}


def slip(angle_rad):
    return [f"encoders:jump@0,angle_rad={angle_rad}"] if angle_rad else []


@pytest.mark.parametrize("overrides", [{"alignment.steer_zero_rad": [0.05, 0.0, -0.02, 0.0]}, {}])
def test_zeros_that_are_found_anew_change_nothing_of_what_is_kept(kept, overrides):
    assert at_rest(overrides=overrides) == pytest.approx(kept["encoders.minus_servo_rad"], abs=0.01)


@pytest.mark.parametrize(("angle_rad", "named"), [(0.0, False), (0.05, True), (-0.5, True)])
def test_the_doctor_names_what_has_slipped(kept, angle_rad, named):
    bench = open_bench("emulated_floor", seed=5, overrides=kept, faults=slip(angle_rad))
    found = [f for f in examine(bench, watch_s=0.3) if f.check.endswith("against its servo")]
    assert len(found) == 4
    assert [f.level for f in found] == ["failure" if named else "ok"] * 4


def test_nothing_is_said_where_nothing_is_kept():
    bench = open_bench("emulated_floor", seed=5, faults=slip(0.5))
    assert not [f for f in examine(bench, watch_s=0.3) if f.check.endswith("against its servo")]


def reported(overrides, angle_rad):
    with open_bench("emulated_floor", seed=5, overrides=overrides, faults=slip(angle_rad)) as bench:
        records = bench.drive(WAY, hold_s=0.1).records
    return [e.message for r in records for e in r.events if e.source == "encoders"]


def test_a_robot_that_is_to_move_says_what_has_slipped(kept):
    assert reported(kept, 0.0) == []
    said = reported(kept, 0.05)
    assert sum("slipped" in one for one in said) == 4
    with pytest.raises(SafetyStop, match="has slipped") as stop:
        reported(kept, 0.5)
    assert stop.value.reason == "horn_slip"


@pytest.mark.long
def test_bring_up_keeps_it_in_the_record_of_the_robot(tmp_path, capsys, kept):
    record = tmp_path / "robot"
    command = ["run", "bring_up", "--bench", "emulated_floor", "--seed", "5", "--out", str(tmp_path / "out")]
    settings = ("devices=servos,encoders,mocap", "watch_s=2", f"bench.record.folder={record}")
    assert main([*command, *(word for one in settings for word in ("--set", one)), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] in ("PASS", "MARGINAL")
    part = RobotRecord(record).read().parts["steering"]
    assert part.values["encoders.minus_servo_rad"] == pytest.approx(
        kept["encoders.minus_servo_rad"], abs=0.01
    )
