"""What a procedure finds gets into the record of its bench once it has passed, and the next run knows it."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from procedure_runs import options_of

from hil.cli import main
from hil.config.loading import load_bench
from hil.config.robot_record import Figure, NewPart, Part, RobotRecord
from hil.config.robot_record.overlay import identity
from hil.procedure import BenchSource, Measurement, procedure
from hil.procedure.record_parts import known_parts, leave_part
from hil.procedure.runner import run_procedure
from hil.procedures.surface_identification.slip import next_lines
from hil.procedures.tracker_extrinsics import Parameters
from hil.procedures.tracker_extrinsics.scale import session_spread


@procedure(name="learns", measurements=[Measurement("off", "mm", high=1.0)])
def learns(ctx):
    """Finds a scale, and passes unless the supply has 11.5 V."""
    scale = Figure(value=1.01, sigma=0.001)
    leave_part(ctx, "camera", values={"tracker.scale": 1.01}, figures={"scale": scale})
    ctx.measure("off", 10.0 * (ctx.source.config.robot.supply_v == 11.5))


def ran(folder, record, proc=learns, **overrides):
    source = BenchSource("emulated", overrides={"record.folder": str(record), **overrides})
    return run_procedure(proc, source, options_of(folder)), source


def test_a_run_that_passes_adds_its_part_and_the_bench_then_has_it(tmp_path):
    result, source = ran(tmp_path / "run", tmp_path / "robot", **{"record.valid_days": 36_500})
    assert result.verdict.value == "PASS"
    assert result.facts["record"]["parts"] == ["camera"]
    part = known_parts(source.config).get("camera")
    assert (part.procedure, part.measured, part.until) == ("learns", "2026-01-01T00:00:00", "2125-12-08")
    config = load_bench("emulated", overrides={"record.folder": str(tmp_path / "robot")})
    assert config.tracker.scale == 1.01
    assert any("is now version 1, with camera" in note for note in result.facts["notes"])


def test_a_run_that_fails_leaves_the_record_as_it_was(tmp_path):
    ran(tmp_path / "run", tmp_path / "robot")
    before = (tmp_path / "robot" / "record.toml").read_bytes()
    result, _ = ran(tmp_path / "again", tmp_path / "robot", **{"robot.supply_v": 11.5})
    assert (result.verdict.value, result.facts["record"]) == ("FAIL", None)
    assert (tmp_path / "robot" / "record.toml").read_bytes() == before
    assert any("was left as it is" in note for note in result.facts["notes"])


def test_a_record_that_does_not_take_it_is_an_error_of_the_run(tmp_path):
    ran(tmp_path / "run", tmp_path / "robot")
    (tmp_path / "robot" / "record.toml.part").mkdir()
    result, _ = ran(tmp_path / "again", tmp_path / "robot")
    assert result.verdict.value == "ERROR"
    assert result.teardown_errors[0].step == "keeping what was found in the record"
    assert RobotRecord(tmp_path / "robot").read().version == 1


def test_a_part_that_was_left_can_be_taken_later(tmp_path):
    result, _ = ran(tmp_path / "run", tmp_path / "robot")
    other = tmp_path / "other"
    source = str(result.folder / "part_camera.toml")
    assert main(["robot", "apply", str(other), "--from", source, "--bench", "emulated"]) == 0
    assert RobotRecord(other).read().parts["camera"].figures["scale"].sigma == 0.001


@dataclass
class Asked:
    """As much of a context as is asked of it."""

    source: BenchSource
    parameters: Parameters


def test_the_scale_from_session_to_session_is_assumed_until_versions_of_the_record_show_it(tmp_path):
    config = load_bench("emulated")
    record = RobotRecord(tmp_path / "robot")
    source = BenchSource("emulated", overrides={"record.folder": str(record.folder)})
    asked = Asked(source, Parameters())
    assert session_spread(asked, 1.0) == pytest.approx(0.001)
    for number in range(12):
        scale = 1.004 if number % 2 else 0.996
        part = Part(
            procedure="a",
            verdict="PASS",
            measured=f"2026-01-{number + 1:02d}",
            bench="b",
            figures={"scale": Figure(value=scale)},
        )
        record.add({"camera": NewPart(part)}, identity(config), created="2026-02-01", why="a test")
    assert session_spread(asked, 1.0) == pytest.approx(0.004, rel=0.15)


def test_the_next_line_is_known_no_better_than_lines_repeat():
    """Mean by direction in wall axes; sigma from repetitions, from what they cannot show, and from tilt."""
    every = {
        "up": [[0.034, 0.001, 0.02], [0.036, 0.003, 0.04]],
        "left": [[0.05, -0.001, 0.0], [0.05, 0.001, 0.0]],
    }
    found = next_lines(every, 0.05)
    assert found["up"].mean == pytest.approx([-0.035, 0.002, 0.03])
    spread_x = np.sqrt(2 * 0.001**2 / 2 * 1.5)
    assert found["up"].sigma[0] == pytest.approx(np.hypot(spread_x, 0.025 * 0.035))
    assert found["left"].sigma[1] > 0.02 * 0.05


def test_the_quick_form_is_that_of_the_procedure_and_set_counts_above_it(capsys):
    words = ["run", "odometry_calibration", "--dry-run", "--json"]
    shown = {}
    for name, more in (("long", []), ("quick", ["--quick"]), ("both", ["--quick", "--set", "line_m=0.7"])):
        assert main([*words, *more]) == 0
        shown[name] = json.loads(capsys.readouterr().out)["parameters"]
    assert shown["long"]["repetitions"] == 5
    assert (shown["quick"]["repetitions"], shown["quick"]["line_m"]) == (2, 1.0)
    assert (shown["both"]["repetitions"], shown["both"]["line_m"]) == (2, 0.7)
    assert main(["run", "grid_scan", "--quick", "--dry-run"]) == 2
    assert "no quick form" in capsys.readouterr().err


def test_backlash_that_is_known_is_what_standard_errors_allow_for(tmp_path):
    from hil.procedures.odometry_calibration.rounds import known_play_rad

    record = RobotRecord(tmp_path / "robot")
    asked = Asked(BenchSource("emulated", overrides={"record.folder": str(record.folder)}), Parameters())
    assert known_play_rad(asked) == pytest.approx(np.radians(0.125))
    part = Part(
        procedure="a",
        verdict="PASS",
        measured="2026-01-01",
        bench="b",
        figures={"FL": Figure(value=0.003), "BL": Figure(value=0.005)},
    )
    record.add({"backlash": NewPart(part)}, identity(load_bench("emulated")), created="2026-02-01", why="t")
    asked = Asked(BenchSource("emulated", overrides={"record.folder": str(record.folder)}), Parameters())
    assert known_play_rad(asked) == 0.0025


@procedure(name="looks", needs=("servos",))
def looks(ctx):
    """Lets the robot rest, and passes unless the supply has 11.5 V."""
    ctx.bench.settle()
    if ctx.source.config.robot.supply_v == 11.5:
        raise RuntimeError


def test_a_run_that_passes_keeps_what_it_confirmed(tmp_path):
    folder = tmp_path / "robot"
    failed, _ = ran(tmp_path / "fails", folder, looks, **{"robot.supply_v": 11.5})
    assert (failed.facts["record"], folder.exists()) == (None, False)
    result, _ = ran(tmp_path / "first", folder, looks)
    assert result.facts["record"] == {"folder": str(folder), "version": 1, "parts": [], "gone": []}
    kept = RobotRecord(folder).read().confirmed
    assert (kept["adhesion.pole_pairs"].value, kept["adhesion.pole_pairs"].procedure) == (3, "looks")
    assert "environment.tilt_rad" not in kept, "where a robot stands is not the robot"
    assert "imu.mount_rotation_wxyz" not in kept, "gravity shows no turn about the vertical"
    again, _ = ran(tmp_path / "second", folder, looks)
    assert (again.facts["record"], RobotRecord(folder).read().version) == (None, 1)
