"""What it costs that sensors are held against each other: processor time of a wall line with and without.

    python benchmarks/cost_of_checks.py --pairs 9

The same line up the wall, with EKF, supervisor and recording in virtual time, is driven in pairs: as it is,
and with the comparisons left out. Those are camera against wheels, gyro and motion capture, servos against
their external encoders, and the look at how well the filter's samples fit. Which of the two comes first
alternates. Printed as one JSON object: the median of the pairs' ratios, their quartiles, and which share of
the time a stopwatch around the comparisons finds; exit code 1 where the checks cost more than a twentieth.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
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
CHECKS = ((MotionCheck, "update"), (SteeringWatch, "judge"), (FilterWatch, "judge"))
Check = Callable[..., Any]


@contextmanager
def replaced(by: Callable[[Check], Check]) -> Iterator[None]:
    """Every comparison is what `by` makes of it."""
    with ExitStack() as stack:
        for kind, name in CHECKS:
            stack.enter_context(patch.object(kind, name, by(getattr(kind, name))))
        yield


def left_out(check: Check) -> Check:
    """Nobody compares."""
    return lambda *given: ()


def timed(spent_s: list[float]) -> Callable[[Check], Check]:
    """Every comparison adds its processor time, s, to a list."""

    def by(check: Check) -> Check:
        def run(*given: Any) -> Any:
            began_s = time.thread_time()
            found = check(*given)
            spent_s.append(time.thread_time() - began_s)
            return found

        return run

    return by


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
    parser.add_argument("--pairs", type=int, default=9)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    cpu_s(2.0)
    found: dict[str, list[float]] = {"with": [], "without": []}
    forms: list[tuple[str, Callable[[], AbstractContextManager[None]]]] = [
        ("with", nullcontext),
        ("without", lambda: replaced(left_out)),
    ]
    for _ in range(options.pairs):
        for name, checks in forms:
            with checks():
                found[name].append(cpu_s(options.seconds))
        forms.reverse()
    spent_s: list[float] = []
    with replaced(timed(spent_s)):
        whole_s = cpu_s(options.seconds) * options.seconds
    ratios = np.divide(found["with"], found["without"])
    low, ratio, high = np.percentile(ratios, (25, 50, 75)).round(3).tolist()
    told = {
        "cpu_s_per_s": {name: round(statistics.median(times), 4) for name, times in found.items()},
        "ratio": ratio,
        "quartiles": [low, high],
        "share_by_stopwatch": round(sum(spent_s) / whole_s, 3),
        "most": MOST,
    }
    print(json.dumps(told, indent=1))
    sys.exit(1 if ratio > MOST else 0)


if __name__ == "__main__":
    main()
