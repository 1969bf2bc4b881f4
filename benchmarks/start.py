"""How long `hil run` takes from the start of its process to the first cycle in which the robot is driven.

    python benchmarks/start.py --runs 7
    python benchmarks/start.py --procedures wall_tracking --cold

Each run is a process of its own that ends with that cycle, in virtual time on the procedure's own bench. The
best of the runs is the one disturbed least: `wall_s` by the clock, `processor_s` by processor time. Two more
runs under `-X importtime` say how much of it is import (`import_share`, of such a run's own time) and which
packages take it (`import_ms`). What numba and Python compiled is kept, and loaded by one run before. With
`--cold` what numba compiles is compiled again, into a folder of its own: `cold_s`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

TARGET_S = 2.0
COLD_TARGET_S = 10.0
PROCEDURES = ("wall_tracking", "steering_zero")
_KEPT = {"PYTHONDONTWRITEBYTECODE": ""}
_LINE_HEAD = "first driven cycle: "


def drive(procedure: str, begun_ns: int) -> None:
    """`hil run` in this process; says how long it took, and ends, once the robot is driven."""
    from hil.cli import run as command
    from hil.cli import script
    from hil.core.interfaces import Sink
    from hil.core.signals import CycleRecord

    class FirstDriven(Sink):
        """Ends the process with the first cycle that has a reference."""

        def write(self, record: CycleRecord) -> None:
            """Tell and end."""
            if record.reference is not None:
                times = {"wall_s": (time.monotonic_ns() - begun_ns) / 1e9, "processor_s": time.process_time()}
                os.write(1, f"{_LINE_HEAD}{json.dumps(times)}\n".encode())
                os._exit(0)

        def close(self) -> None:
            """A bench that closed before it drove is no start."""

    command.watching = lambda: (FirstDriven(),)
    sys.argv = ["hil", "run", procedure]
    script()


def once(procedure: str, *options: str, **environment: str) -> tuple[dict[str, float], str]:
    """Seconds until the first driven cycle of a fresh process, and what it said on stderr."""
    command = [
        sys.executable,
        *options,
        str(Path(__file__).resolve()),
        "--drive",
        procedure,
        "--begun",
        str(time.monotonic_ns()),
    ]
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, env={**os.environ, **_KEPT, **environment}
        )
    times_line = [line for line in done.stdout.splitlines() if line.startswith(_LINE_HEAD)]
    if not times_line:
        raise SystemExit(f"{procedure}: {done.stderr[-2000:]}")
    times: dict[str, float] = json.loads(times_line[0].removeprefix(_LINE_HEAD))
    return times, done.stderr


def imports(procedure: str) -> tuple[float, Counter[str]]:
    """Part of a run that is import, and microseconds of every module."""
    found: Counter[str] = Counter()
    times, said = min(
        (once(procedure, "-X", "importtime") for _ in range(2)), key=lambda run: run[0]["wall_s"]
    )
    for line in said.splitlines():
        if line.startswith("import time:") and "|" in line:
            own_us, _, name = line.removeprefix("import time:").split("|")
            if own_us.strip().isdigit():
                found[name.strip()] += int(own_us)
    return sum(found.values()) / 1e6 / times["wall_s"], found


def measured(procedure: str, runs: int, *, cold: bool) -> dict[str, Any]:
    """What is printed of one procedure."""
    once(procedure)
    found = [once(procedure)[0] for _ in range(runs)]
    share, loaded = imports(procedure)
    by_package: Counter[str] = Counter()
    for name, us in loaded.items():
        by_package[name.split(".")[0]] += us
    best = {key: round(min(run[key] for run in found), 3) for key in found[0]}
    figures = {
        **best,
        "target_s": TARGET_S,
        "import_share": round(share, 2),
        "import_ms": {name: round(us / 1e3, 1) for name, us in by_package.most_common(8)},
    }
    if cold:
        with tempfile.TemporaryDirectory() as folder:
            figures |= {"cold_s": round(once(procedure, NUMBA_CACHE_DIR=folder)[0]["wall_s"], 1)}
            figures["cold_target_s"] = COLD_TARGET_S
    return figures


def main() -> None:
    """Print one JSON object, a procedure each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--procedures", default=",".join(PROCEDURES))
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--cold", action="store_true")
    parser.add_argument("--drive", help=argparse.SUPPRESS)
    parser.add_argument("--begun", type=int, default=0, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.drive:
        drive(given.drive, given.begun)
    names = given.procedures.split(",")
    print(json.dumps({name: measured(name, given.runs, cold=given.cold) for name in names}, indent=1))


if __name__ == "__main__":
    main()
