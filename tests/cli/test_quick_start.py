"""What a command does not use it does not import: a start is what every short run and every campaign pays."""

import subprocess
import sys

import pytest

SOLVERS = {"scipy.optimize", "scipy.stats", "hil.calibration.solvers", "hil.calibration.calibrate"}
DRAWING = {"matplotlib"}


@pytest.mark.parametrize(
    ("modules", "unused"),
    [
        (
            "hil.procedures.wall_tracking, hil.procedures.bring_up, hil.procedures.latency, "
            "hil.procedures.adhesion_check, hil.procedures.imu_calibration, "
            "hil.procedures.surface_identification, hil.procedures.tracker_extrinsics, "
            "hil.procedure.runner, hil.bench, hil.live, hil.replay.estimator_comparison, "
            "hil.replay.recordings",
            SOLVERS | DRAWING,
        ),
        ("hil.calibration.calibrate", DRAWING),
    ],
)
def test_what_is_not_used_is_not_imported(modules, unused):
    script = f"import {modules}, sys; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert not unused & set(loaded.stdout.split())
