"""Processor time of the commands that answer at once, also beside another checkout, in turns.

    python benchmarks/commands.py
    python benchmarks/commands.py --against /path/to/other/checkout

Each command runs once to warm up, then `--runs` times in a process of its own, in turns with the other
checkout, which needs a `.venv` of its own. The medians of user and system time are printed in seconds, and
`share`, ours over the other's, beside the goal.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

COMMANDS = {
    "hil run --help": (["run", "--help"], 1 / 5),
    "hil list procedures": (["list", "procedures"], 1 / 5),
    "hil list": (["list"], 1 / 4),
    "hil info": (["info"], 1 / 3),
    "completion of hil run wall": ("hil run wall", 1 / 4),
    "completion of hil run bring_up --fault imu:": ("hil run bring_up --fault imu:", 1 / 4),
}
"""Words of a command, or a line that is completed; and the goal for its share."""


def once(hil: Path, asked: list[str] | str, folder: str) -> float:
    """Processor time of one process, s."""
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": ""}
    words = asked if isinstance(asked, list) else []
    if isinstance(asked, str):
        environment |= {"_HIL_COMPLETE": "bash_complete", "COMP_WORDS": asked}
        environment["COMP_CWORD"] = str(len(asked.split()) - 1)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([str(hil), *words], env=environment, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measured(asked: list[str] | str, commands: dict[str, Path], runs: int) -> dict[str, float]:
    """Medians of all checkouts, measured in turns."""
    times: dict[str, list[float]] = {name: [] for name in commands}
    with tempfile.TemporaryDirectory() as folder:
        for k in range(runs + 1):
            for name, hil in commands.items():
                taken = once(hil, asked, folder)
                if k:
                    times[name].append(taken)
    return {name: round(statistics.median(taken), 3) for name, taken in times.items()}


def main() -> None:
    """Print one JSON object, a command each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--against", type=Path, help="folder of another checkout, with its .venv")
    given = parser.parse_args()
    commands = {"ours_s": Path(sys.executable).with_name("hil")}
    if given.against:
        commands["other_s"] = given.against / ".venv" / "bin" / "hil"
    found: dict[str, dict[str, Any]] = {}
    for name, (asked, goal) in COMMANDS.items():
        figures: dict[str, Any] = measured(asked, commands, given.runs)
        if given.against:
            figures |= {"share": round(figures["ours_s"] / figures["other_s"], 3), "goal": round(goal, 2)}
        found[name] = figures
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
