"""Runs with several faults at once: what is drawn, and which made-up runs are red."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from hil.bench import Held, supported_faults
from hil.config.loading import load_bench
from hil.fault_matrix import Cell
from hil.fault_matrix.observation import Seen
from hil.faults.fault import parse_fault

BENCHMARK = runpy.run_path(str(Path(__file__).resolve().parents[2] / "benchmarks" / "multiple_faults.py"))
LOOKED_S = 9.5


def test_a_run_is_drawn_by_its_number_with_faults_of_every_moment_and_of_the_wire():
    supported, draw = supported_faults(load_bench("emulated")), BENCHMARK["drawn"]
    cells = [draw(run, "own", supported) for run in range(200)]
    assert cells == [draw(run, "own", supported) for run in range(200)]
    assert all(cell.specs == draw(run, "mujoco", supported).specs for run, cell in enumerate(cells))
    faults = [[parse_fault(spec) for spec in cell.specs] for cell in cells]
    assert {len(row) for row in faults} == {2, 3, 4}
    assert all(set(f.options) <= set(supported[f.device][f.kind]) for row in faults for f in row)
    moments = np.histogram([f.start_ns * 1e-9 for row in faults for f in row], bins=[0, 0.45, 3.15, 9.5, 14])
    assert moments[0].min() > 50
    kinds = [{(f.device, f.kind) for f in row} for row in faults]
    assert sum(("adhesion", "wrong") in row or ("thrust", "wrong") in row for row in kinds) > 50
    assert sum(any(kind in ("silent", "pieces") for _, kind in row) for row in kinds) > 50


def red(specs=("imu:wrong@1.3", "servos:off@1.5+0.2"), **given):
    names, kinds = zip(*(spec.partition("@")[0].split(":") for spec in specs), strict=True)
    cell = Cell("+".join(names), "+".join(kinds), "random", 1, "own", tuple(specs))
    seen = Seen(**{"cycles": 300, "held": Held("HELD", 0.0, ""), "looked_s": LOOKED_S, **given})
    return list(BENCHMARK["broken"](cell, seen))


NOT_HELD = Held("NOT HELD", None, "")
SLIPS = {"crept_m": 0.02}
FAN_GONE = {"fallen": True, "held": NOT_HELD, "adhesion_n": 3.0}


@pytest.mark.parametrize(
    ("specs", "seen", "expected"),
    [
        (("imu:wrong@1.3", "thrust:slow@2"), {}, ""),
        (("imu:wrong@1.3", "thrust:slow@2"), {"fallen": True, "held": NOT_HELD}, "fell with"),
        (("adhesion:off@1.3", "thrust:slow@2"), FAN_GONE, ""),
        (("adhesion:wrong@1.3,factor=2", "imu:off@2"), FAN_GONE, "fell with 3.0 N"),
        (("adhesion:drop@1.3,direction=out,probability=0.9", "imu:off@2"), FAN_GONE, ""),
        (("adhesion:drop@1.3,probability=0.9", "imu:off@2"), FAN_GONE, "fell with 3.0 N"),
        (("thrust:wrong@1.3,factor=0.4", "imu:off@2"), {"fallen": True, "held": NOT_HELD}, ""),
        (("thrust:wrong@1.3,factor=0.6", "imu:off@2"), {"fallen": True, "held": NOT_HELD}, "fell with"),
        (("thrust:wrong@1.3,factor=2.2", "imu:off@2"), {"fallen": True, "held": NOT_HELD}, "fell with"),
        (("thrust:wrong@1.3,factor=3", "imu:off@2"), {"fallen": True}, "and fell"),
        (("thrust:wrong@9.6,factor=3", "imu:off@2"), {"fallen": True, "crept_m": 9.0}, ""),
        (("adhesion:off@1.3", "imu:off@2"), {"fallen": True, "adhesion_n": 3.0, "crept_m": 9.0}, "and fell"),
        (("adhesion:off@9.6", "imu:off@2"), {"fallen": True, "adhesion_n": 3.0, "crept_m": 9.0}, ""),
        (("servos:off@1.3", "imu:off@2"), SLIPS, "20.0 mm after HELD"),
        (("servos:off@9.6", "imu:off@2"), SLIPS, ""),
        (("servos:off@9.6+0.1", "imu:off@2"), {"crept_m": 0.05}, "50.0 mm after HELD"),
        (("imu:off@9.6", "servos:off@2"), SLIPS, "20.0 mm after HELD"),
        (("imu:off@9.6", "servos:off@2"), {"crept_m": np.nan}, "after HELD"),
        (("servos:off@1.3", "imu:off@2"), {**SLIPS, "held": NOT_HELD}, ""),
        (("adhesion:off@1.3", "imu:off@2"), {"held_adhesion_n": 20.0}, "reported HELD with 20.0 N"),
        (("thrust:wrong@9,factor=4", "imu:off@2"), {"most_thrust_n": 120.0}, "pushed by 120 N"),
        (("imu:off@9", "thrust:slow@2"), {"foreign": "KeyError: 1"}, "KeyError"),
    ],
)
def test_a_run_is_red_where_the_true_robot_was_let_go(specs, seen, expected):
    found = "; ".join(red(specs, **seen))
    assert expected in found
    assert bool(found) is bool(expected)
