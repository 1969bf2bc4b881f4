"""How many times faster than real time a recording is replayed and verified.

    python benchmarks/replay.py --seconds 120 --runs 5

A drive of the emulated bench is recorded in virtual time with UKF and odometry beside the EKF. `verify` is
what `hil replay --verify` does from opening the file to the last compared bit, `verify_ekf` the same without
observers, `compare` what `hil replay` does: odometry, EKF, UKF and smoother, and their table. Ratios are
recorded seconds over processor time of this process, so that other work on the machine matters less; the
best run is the one disturbed least. `command_wall` is the whole command by the wall clock, start included.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import hil
from hil.recording.mcap_writer import McapRecorder
from hil.replay.estimator_comparison import compare_run, table
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_recording
from hil.robot.trajectories import scan

TARGET = 20.0
LANE_M = 0.6


def record(path: Path, seconds: float, observers: tuple[str, ...]) -> float:
    """Record a scan of about that long; returns its length in seconds."""
    lanes = 1
    while (trajectory := scan((0.0, 0.0, 0.0), LANE_M, lanes, 0.1)).duration_s < seconds:
        lanes += 1
    bench = hil.open_bench("emulated", seed=4)
    bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
    with bench:
        motion = bench.drive(trajectory, observers=observers, hold_s=0.5)
    return float(motion.t_s[-1])


def verified(path: Path) -> None:
    """All that `hil replay --verify` compares; raises where a bit differs."""
    for run in verify_recording(open_recording(path))["runs"]:
        if run["difference"] is not None:
            raise SystemExit(f"{path}: {run['difference']}")


def compared(path: Path) -> None:
    """The estimators of `hil replay` on the longest run, and their table."""
    opened = open_recording(path)
    run = max(opened.runs, key=lambda r: len(r.records))
    table(compare_run(run, opened.bench))


def ratios(work: Callable[[Path], None], path: Path, seconds: float, runs: int) -> dict[str, float]:
    """Recorded seconds per second of processor time, after one run that loads the kernels."""
    work(path)
    found = []
    for _ in range(runs):
        began_s = time.process_time()
        work(path)
        found.append(seconds / (time.process_time() - began_s))
    return {"median": round(statistics.median(found), 1), "best": round(max(found), 1)}


def main() -> None:
    """Measure and print one JSON object; exit code 1 when the best run misses the target."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--runs", type=int, default=5)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        alone, beside = Path(folder) / "alone.mcap", Path(folder) / "beside.mcap"
        alone_s, beside_s = (
            record(alone, arguments.seconds, ()),
            record(beside, arguments.seconds, ("ukf", "odometry")),
        )
        out: dict[str, object] = {"recorded_s": round(beside_s, 1), "target": TARGET}
        measured = {
            "verify": ratios(verified, beside, beside_s, arguments.runs),
            "verify_ekf": ratios(verified, alone, alone_s, arguments.runs),
            "compare": ratios(compared, beside, beside_s, arguments.runs),
        }
        began_s = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "hil.cli", "replay", str(beside), "--verify"],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        out |= {**measured, "command_wall": round(beside_s / (time.perf_counter() - began_s), 1)}
    print(json.dumps(out, indent=1))
    raise SystemExit(any(m["best"] < TARGET for m in measured.values()))


if __name__ == "__main__":
    main()
