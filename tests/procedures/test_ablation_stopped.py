"""A robot that the bench stops while little is known of it still shows what its record is worth."""

from pathlib import Path

import pytest
from procedure_runs import run

from hil.config.robot_record import NewPart, Part, RobotRecord
from hil.config.robot_record.overlay import identity
from hil.procedure import BenchSource
from hil.report.ablation_figure import EVERYTHING, NOTHING
from tests.patience import FANLESS

SCALE, LENGTH_M = 0.77, 0.3
LINE = {"cases": ["x_line"], "length_m": LENGTH_M, "duration_s": 10.0, "hold_s": 0.5, "processes": 1}


def with_known_camera(folder):
    """A bench whose camera reads far too short, and a record that knows by how much."""
    overrides = {
        "emulation.tracker": {"scale": SCALE, "scale_sigma": 0.0},
        "record.folder": str(folder / "robot"),
    }
    source = BenchSource("emulated", seed=3, overrides=overrides)
    known = Part(
        procedure="tracker_extrinsics",
        verdict="PASS",
        measured="2026-11-22",
        bench="emulated",
        values={"tracker.scale": SCALE, "tracker.scale_sigma": 0.002},
    )
    who = identity(source.config, source.seed)
    RobotRecord(Path(source.config.record.folder)).add(
        {"camera": NewPart(known)}, who, created="2026-11-22", why="measured"
    )
    return overrides


def test_a_line_that_a_check_ends_counts_as_far_as_it_came(tmp_path):
    done = run(
        "wall_ablation",
        tmp_path / "run",
        LINE,
        bench="emulated",
        seed=3,
        overrides=FANLESS | with_known_camera(tmp_path),
    )
    wall = done.result.facts["data"]["wall"]
    assert wall[NOTHING]["x_line"]["end_m"] > 0.1 * LENGTH_M
    assert wall[EVERYTHING]["x_line"]["end_m"] < 0.01
    assert done.values["x_line.nothing_known.end"] == pytest.approx(1e3 * wall[NOTHING]["x_line"]["end_m"])
    assert any("sensors_disagree" in note for note in done.result.facts["notes"])
    assert not done.failed
    done.assert_held()
