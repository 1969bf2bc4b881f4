"""What it costs that sensors are held against each other: processor time of a wall line with and without.

    python benchmarks/cost_of_checks.py --runs 6

The same line up the wall, with EKF, supervisor and recording in virtual time, is driven in turn as it is and
with the comparisons left out: camera against wheels, gyro and motion capture, servos against their external
encoders, and the look at how well the filter's samples fit. Printed is the ratio of the quickest runs, as one
JSON object; exit code 1 where the checks cost more than a twentieth.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import hil
from hil.recording.mcap_writer import McapRecorder
from hil.ring.crosscheck import SteeringWatch
from hil.ring.filter_watch import FilterWatch
from hil.ring.motion_check import MotionCheck
from hil.robot.trajectories import line

MOST = 1.05


def _nothing(*_: Any) -> tuple[()]:
    return ()


@contextmanager
def without_checks() -> Iterator[None]:
    """Nobody compares."""
    with (
        patch.object(MotionCheck, "update", _nothing),
        patch.object(SteeringWatch, "judge", _nothing),
        patch.object(FilterWatch, "judge", _nothing),
    ):
        yield


def cpu_s(seconds: float) -> float:
    """Processor time of a second of the line, s."""
    start = np.zeros(3)
    way = line(start, np.array([0.03 * seconds, 0.0, 0.0]), duration_s=seconds)
    with tempfile.TemporaryDirectory() as folder, hil.open_bench("emulated", seed=1) as bench:
        bench.add_sink(McapRecorder(str(Path(folder) / "run.mcap"), bench.header(), lossless=True))
        began_s = time.process_time()
        bench.drive(way, start_pose=start)
        return (time.process_time() - began_s) / seconds


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    cpu_s(2.0)
    found: dict[str, list[float]] = {"with": [], "without": []}
    for _ in range(options.runs):
        for name, checks in (("with", nullcontext()), ("without", without_checks())):
            with checks:
                found[name].append(cpu_s(options.seconds))
    ratio = min(found["with"]) / min(found["without"])
    told = {name: round(min(times), 5) for name, times in found.items()}
    print(json.dumps({"cpu_s_per_s": told, "ratio": round(ratio, 3), "most": MOST}, indent=1))
    sys.exit(1 if ratio > MOST else 0)


if __name__ == "__main__":
    main()
