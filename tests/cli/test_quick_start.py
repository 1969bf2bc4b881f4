"""What a command does not use it does not import: a start is what every short run and every campaign pays."""

import subprocess
import sys

import pytest

SOLVERS = {"scipy.optimize", "scipy.stats", "hil.calibration.solvers", "hil.calibration.calibrate"}
DRAWING = {"matplotlib"}


@pytest.mark.parametrize(
    ("modules", "unused"),
    [
        ("hil.procedures.wall_tracking, hil.procedure.runner", SOLVERS | DRAWING),
        ("hil.procedures.bring_up, hil.procedures.latency", {"scipy", *SOLVERS, *DRAWING}),
        (
            "hil.procedures.adhesion_check, hil.procedures.imu_calibration, "
            "hil.procedures.surface_identification, hil.procedures.tracker_extrinsics",
            {"scipy.stats", "scipy.optimize", *DRAWING},
        ),
        ("hil.bench, hil.live", SOLVERS | DRAWING),
        ("hil.replay.comparison, hil.replay.recordings", SOLVERS | DRAWING),
        ("hil.calibration.calibrate", DRAWING),
    ],
)
def test_what_is_not_used_is_not_imported(modules, unused):
    script = f"import {modules}, sys; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert not unused & set(loaded.stdout.split())


def test_a_kernel_that_is_called_does_not_load_fortrans_wrappers():
    pytest.importorskip("numba")
    script = """
import sys
import numpy as np
from hil.vocabulary.kernels import compiled

@compiled
def twice(x):
    return 2.0 * x

print(twice(1.5), "numpy.f2py.crackfortran" in sys.modules)
from numpy import *
print("numpy.f2py.crackfortran" in sys.modules, bool(np.f2py.crackfortran.__doc__))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["3.0", "False", "False", "True"]
