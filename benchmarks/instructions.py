"""Instructions of the processor that a control cycle in virtual time takes, counted by valgrind.

    python benchmarks/instructions.py five wall_of_five --tree ../before

Times on a shared computer differ by a tenth from minute to minute. Instructions do not: two runs of one
tree differ by less than 0.1 %, whatever else runs. So a change that wins one per cent is seen. Instructions
are not times: code whose data are not in the cache takes longer. What is counted are the works of
`virtual_pair.py`, cycles 150 to 350, with numba's machine code for any x86-64 processor. Needs
`apt install valgrind`; takes half a minute each.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from virtual_pair import HERE, WORKS

FIRST, COUNTED = 150, 200
SECONDS = 30.0
_TOTAL = re.compile(r"^(?:summary|totals):\s*(\d+)", re.MULTILINE)


def drive(work: str) -> None:
    """Run a work; counting is on for some of its cycles, after which the process ends."""
    cycles = 0

    def cycle() -> None:
        nonlocal cycles
        cycles += 1
        if cycles in (FIRST, FIRST + COUNTED) and "CALLGRIND" in os.environ:
            state = "on" if cycles == FIRST else "off"
            command = ["callgrind_control", "-i", state, str(os.getpid())]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        if cycles == FIRST + COUNTED:
            os._exit(0)

    WORKS[work](SECONDS, cycle)


def count(tree: Path, work: str, scratch: Path) -> int:
    """Instructions of a cycle of a tree.

    Raises:
        SystemExit: the work failed, with what it said.
    """
    environment = {
        **os.environ,
        "PYTHONPATH": str(tree),
        "PYTHONHASHSEED": "0",
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
        "NUMBA_CACHE_DIR": str(scratch / "numba"),
    }
    found = scratch / f"{work}.callgrind"
    plain = [sys.executable, __file__, "--drive", work]
    counted = ["valgrind", "--tool=callgrind", "--instr-atstart=no", f"--callgrind-out-file={found}", *plain]
    for command, more in ((plain, {}), (counted, {"CALLGRIND": "1"})):  # the first compiles
        done = subprocess.run(
            command, env={**environment, **more}, cwd=scratch, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise SystemExit(f"{' '.join(command)} in {tree} failed:\n{done.stdout}{done.stderr}")
    return int(_TOTAL.findall(found.read_text(encoding="utf-8"))[-1]) // COUNTED


def main() -> None:
    """Count and print one JSON object."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("works", nargs="*", metavar="WORK", help=f"any of {', '.join(WORKS)} [default: all]")
    parser.add_argument("--tree", type=Path, default=HERE, help="another source tree")
    parser.add_argument("--drive", choices=tuple(WORKS), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.drive:
        return drive(arguments.drive)
    unknown = [work for work in arguments.works if work not in WORKS]
    if unknown:
        parser.error(f"{', '.join(unknown)}: expected any of {', '.join(WORKS)}")
    if shutil.which("valgrind") is None:
        parser.error("valgrind is not installed: apt install valgrind")
    tree = arguments.tree.resolve()
    with tempfile.TemporaryDirectory() as scratch:
        counts = {work: count(tree, work, Path(scratch)) for work in arguments.works or WORKS}
    print(json.dumps(counts, indent=1))


if __name__ == "__main__":
    main()
