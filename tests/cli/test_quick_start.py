"""What a command does not use it does not import: a start is what every short run and every campaign pays."""

import os
import subprocess
import sys
from importlib.metadata import entry_points

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


HEAVY = {"numba", "scipy", "pydantic", "matplotlib", "hil.bench.bench", "hil.core.registry"}
PACKAGES = HEAVY - {"hil.core.registry"} | {"numpy"}


@pytest.mark.parametrize(
    ("words", "environment", "unused"),
    [
        (["run", "--help"], {}, PACKAGES),
        (["list"], {}, PACKAGES),
        (["info"], {}, HEAVY),
        ([], {"_HIL_COMPLETE": "bash_complete", "COMP_WORDS": "hil run wall", "COMP_CWORD": "2"}, PACKAGES),
        (
            [],
            {"_HIL_COMPLETE": "bash_complete", "COMP_WORDS": "hil run x --fault i", "COMP_CWORD": "4"},
            PACKAGES,
        ),
    ],
)
def test_a_command_that_runs_no_bench_loads_none(words, environment, unused):
    """Where no package of devices is installed: such a one is imported to be listed."""
    if entry_points(group="hil.devices"):
        pytest.skip("a package of devices is installed")
    tell = "atexit.register(lambda: print(*sys.modules, file=sys.stderr))"
    script = f"import atexit, sys; {tell}; sys.argv[1:] = {words}; from hil.cli import script; script()"
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        check=True,
    )
    assert done.stdout
    assert not unused & set(done.stderr.split())
