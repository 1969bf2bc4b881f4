"""Is the filter as sure as it may be on the emulated wall? Errors, NEES and NIS with three sets of noise.

`python benchmarks/wall_noise.py 1 2 3 4` drives the X line and the Y line of `wall_tracking` in the worlds
with these seeds (half a minute of processor time each; `--plant mujoco` in the second physics) and
estimates the recordings three times: with the noise of the profile `emulated`, which is what its sensors
have, with the same and wheels that are surer of their way across, and with the defaults, which are for
hardware. It prints the table of docs/estimation.md.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hil.cli import main
from hil.config.bench import BenchConfig
from hil.config.estimator import EstimatorConfig
from hil.estimator import make_estimator
from hil.recording.runs import RecordedRun
from hil.replay.estimator_comparison import consistency, estimate
from hil.replay.recordings import OpenedRecording, open_recording
from hil.replay.truth_errors import errors

LINES = ("x_line", "y_line")
ROWS = {"wheels": 8, "gyro": 1, "tracker": 3}
SURER_ACROSS = 5e-4
COLUMNS = ("rmse mm", "end mm", "deg", "NEES", "scale %", *(f"NIS {name}" for name in ROWS))


def driven(seed: int, plant: str, folder: Path) -> dict[str, OpenedRecording]:
    """Recordings of one world by line."""
    wanted = (
        'feedbacks=["ekf"]',
        "optimal=false",
        f"cases={','.join(LINES)}",
        f"bench.emulation.plant={plant}",
    )
    settings = [word for setting in wanted for word in ("--set", setting)]
    with contextlib.redirect_stdout(io.StringIO()):
        code = main(["run", "wall_tracking", "--seed", str(seed), *settings, "--out", str(folder)])
    if code != 0:
        raise SystemExit(f"wall_tracking with seed {seed}: exit code {code}")
    return {line: open_recording(folder / f"recording_{line}_ekf_seed_{seed}.mcap") for line in LINES}


def figures(config: EstimatorConfig, recording: OpenedRecording) -> list[float]:
    """The `COLUMNS` of one estimator on the longest run of a recording."""
    run: RecordedRun = max(recording.runs, key=lambda r: len(r.records))
    bench: BenchConfig = recording.bench.config
    estimator = make_estimator(config, recording.bench.geometry, surface=bench.environment.kind)
    if run.start is None:
        raise SystemExit("a recording does not say how its run began")
    motion = estimate(run.records, estimator, run.start.state)
    far, sure = errors(motion), consistency(motion)
    nis = [np.nanmean(motion.diagnostic(f"nis_{name}")) / rows for name, rows in ROWS.items()]
    last = motion.records[-1].state.diagnostics["scale"]
    return [
        1e3 * far["rmse_position_m"],
        1e3 * far["final_position_m"],
        float(np.rad2deg(far["rmse_theta_rad"])),
        sure["nees_pose"],
        100.0 * last,
        *map(float, nis),
    ]


def table(seeds: Sequence[int], plant: str) -> str:
    """Means over the worlds, one row per line and set of noise."""
    found: dict[str, list[list[float]]] = {}
    for seed in seeds:
        with tempfile.TemporaryDirectory() as scratch:
            for line, recording in driven(seed, plant, Path(scratch) / "run").items():
                own = recording.bench.config.estimator
                surer = own.model_copy(
                    update={"wall": own.wall.model_copy(update={"creep_across": SURER_ACROSS})}
                )
                sets = (("profile", own), ("surer across", surer), ("defaults", EstimatorConfig()))
                for label, config in sets:
                    found.setdefault(f"{line}, {label}", []).append(figures(config, recording))
    lines = ["| | " + " | ".join(COLUMNS) + " |", "|---" * (len(COLUMNS) + 1) + "|"]
    for label, rows in sorted(found.items()):
        lines.append(f"| {label} | " + " | ".join(f"{v:.3f}" for v in np.mean(rows, axis=0)) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seeds", type=int, nargs="*", default=[1])
    parser.add_argument("--plant", choices=("own", "mujoco"), default="own")
    asked = parser.parse_args()
    print(table(asked.seeds, asked.plant))
