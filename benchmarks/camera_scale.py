"""What it is worth to know the camera's scale: the same worlds with and without `tracker_extrinsics`.

    python benchmarks/camera_scale.py --seeds 8

In each world the camera is measured on the floor by `tracker_extrinsics`; then the robot drives 1.5 m up
the wall under the EKF, once as the profile says and once with the fragment that the procedure wrote.
`end` is the true pose minus the goal along the way after two seconds at rest. `scale` is what the
procedure found beside the world's own, `sigmas` their difference in standard uncertainties.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench import open_bench
from hil.config.loading import load_bench
from hil.core.clock import MonotonicClock
from hil.fakes.world import random_stream
from hil.procedure.bench_fragment import NAME
from hil.procedure.bench_source import BenchSource
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.runner import RunOptions, run_procedure
from hil.procedure.tracking_errors import enable_hold, tracking_errors
from hil.robot.trajectories import line

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

WAY_M, DURATION_S = 1.5, 30.0


def true_scale(seed: int) -> float:
    """Way over true way of the camera of an emulated world: the first draw of its stream."""
    sigma = float(load_bench("emulated").emulation.tracker["scale_sigma"])
    return 1.0 + sigma * float(random_stream(seed, "tracker").standard_normal())


def measured(seed: int, folder: Path) -> dict[str, Any]:
    """Overrides by the fragment that `tracker_extrinsics` leaves in a world; the true mount stays."""
    proc = load_procedure("tracker_extrinsics")
    options = RunOptions(folder, MonotonicClock(), "", {})
    result = run_procedure(proc, BenchSource(proc.bench, seed=seed), options)
    if result.exit_code != 0:
        raise SystemExit(f"tracker_extrinsics: {result.verdict.value} in world {seed}")
    fragment = tomllib.loads((folder / NAME).read_text(encoding="utf-8"))["tracker"]
    config = load_bench("emulated")
    assert config.tracker is not None
    stays = {name: getattr(config.tracker, name) for name in ("mount_position_m", "mount_rotation_wxyz")}
    found: dict[str, Any] = {f"tracker.{key}": value for key, value in fragment.items()}
    return {**found, "emulation.tracker": {**config.emulation.tracker, **stays}}


def climbed(seed: int, overrides: dict[str, Any]) -> dict[str, float]:
    """Errors of the true pose on the way up, in mm and deg."""
    with open_bench("emulated", seed=seed, overrides=overrides) as bench:
        start = enable_hold(bench)
        reference = line(start, start + np.array([WAY_M, 0.0, 0.0]), duration_s=DURATION_S)
        return tracking_errors(bench.drive(reference, feedback="ekf", start_pose=start))


def rms(values: list[float]) -> float:
    """Root mean square."""
    return math.sqrt(sum(v * v for v in values) / len(values))


def main() -> None:
    """Measure and print one line per world, and the means."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=8)
    before, after, ways, offs = [], [], [], []
    print("world     scale      true    sigma  sigmas | end before   after | RMSE x before  after   (mm)")
    for seed in range(parser.parse_args().seeds):
        with tempfile.TemporaryDirectory() as folder:
            found = measured(seed, Path(folder) / "run")
        plain, known, true = climbed(seed, {}), climbed(seed, found), true_scale(seed)
        before.append(plain["end_x"])
        after.append(known["end_x"])
        ways.append((plain["rmse_x"], known["rmse_x"]))
        offs.append((found["tracker.scale"] - true) / found["tracker.scale_sigma"])
        print(
            f"{seed:5}  {found['tracker.scale']:8.5f}  {true:8.5f}  {found['tracker.scale_sigma']:.5f}"
            f"  {offs[-1]:6.2f} | {plain['end_x']:10.2f} {known['end_x']:7.2f} | {plain['rmse_x']:13.2f}"
            f" {known['rmse_x']:6.2f}",
            flush=True,
        )
    mean = np.mean(ways, axis=0)
    print(f"rms: sigmas {rms(offs):.2f}, end {rms(before):.2f} -> {rms(after):.2f} mm;", end=" ")
    print(f"mean RMSE x {mean[0]:.2f} -> {mean[1]:.2f} mm")


if __name__ == "__main__":
    main()
