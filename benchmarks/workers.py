"""How much more two workers of a campaign get done than one, and how much two processes could at most.

    python benchmarks/workers.py --runs 8

A campaign of so many wall lines with EKF (30 s each, recorded, with report) runs with one worker, then with
two, then with two that keep the results alone. Beside it stands what the computer itself gives: the same
`hil run` alone, and two of them at once, which share nothing but the cores. Two cores that share caches,
memory and the host's time give less than twice. `thousand_min` is what 1,000 runs would take at the rate of
two workers, `thousand_results_min` the same of the results alone. `stolen_s` is processor time that the host
took meanwhile. Let nothing else run.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from host import stolen_s

WANTED = 1.8
FEW = 2
"""Runs of a campaign that is mostly start."""
LINE = ("wall_tracking", "--set", 'cases=["x_line"]', "--set", 'feedbacks=["ekf"]')


def started(command: str, *options: str, out: Path) -> subprocess.Popen[bytes]:
    """A process of the command line."""
    words = [sys.executable, "-m", "hil", command, *LINE, *options, "--out", str(out)]
    return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def finished_s(command: str, *several: tuple[str, ...]) -> float:
    """How long it takes until processes that are started at once have all ended, s.

    A failed limit is no failure of a benchmark; everything else is.
    """
    with tempfile.TemporaryDirectory() as folder:
        begun = time.monotonic()
        processes = [
            started(command, *options, out=Path(folder) / str(k)) for k, options in enumerate(several)
        ]
        codes = [process.wait() for process in processes]
        taken_s = time.monotonic() - begun
    if not set(codes) <= {0, 1}:
        raise SystemExit(f"hil {command} ended with {codes}: run it by hand to see why")
    return taken_s


def campaign_s(runs: int, workers: int, keep: str = "all") -> float:
    """How long a campaign takes, s."""
    return finished_s("campaign", ("--seeds", f"0:{runs}", "--workers", str(workers), "--keep", keep))


def thousand_min(few_s: float, many_s: float, runs: int) -> float:
    """What 1,000 runs would take, min: a campaign of few runs, and the rate at which more are added."""
    return round((few_s + (1000 - FEW) * (many_s - few_s) / (runs - FEW)) / 60.0, 1)


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=8, help="of each campaign, more than two")
    runs = parser.parse_args().runs
    if runs <= FEW:
        parser.error(f"--runs {runs}: a rate needs more than the {FEW} runs that tell how long a start takes")
    before_s = stolen_s()
    alone_s = finished_s("run", ("--seed", "0"))
    at_once_s = finished_s("run", ("--seed", "0"), ("--seed", "1"))
    few_s, one_s, two_s = campaign_s(FEW, 2), campaign_s(runs, 1), campaign_s(runs, 2)
    few_results_s, results_s = campaign_s(FEW, 2, "results"), campaign_s(runs, 2, "results")
    result = {
        "run_alone_s": round(alone_s, 2),
        "two_runs_at_once_s": round(at_once_s, 2),
        "two_processes": round(2.0 * alone_s / at_once_s, 3),
        "one_worker_s": round(one_s, 1),
        "two_workers_s": round(two_s, 1),
        "two_workers": round(one_s / two_s, 3),
        "wanted": WANTED,
        "two_workers_results_s": round(results_s, 1),
        "thousand_min": thousand_min(few_s, two_s, runs),
        "thousand_results_min": thousand_min(few_results_s, results_s, runs),
        "stolen_s": round(stolen_s() - before_s, 1),
    }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
