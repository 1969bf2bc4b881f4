"""Writes the table of docs/estimation.md that shows the estimators on the demo's recordings.

Run it after a change that moves them (`python docs/make_estimation_figures.py`); a test compares. The
recordings are those of `make demo`, bit for bit: every drive of `wall_tracking` has a world of its own.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from hil.cli import main

PAGE = Path(__file__).with_name("estimation.md")
SEED = 1
LINES = ("x_line", "y_line")
SHOWN = "out/demo"
STARTED = ("bench.emulation.adhesion.start=tethered", "bench.emulation.thrust.start=tethered")
"""The demo starts fan and propellers itself."""


def recording(line: str) -> str:
    """Name of a line's recording in the results folder."""
    return f"recording_{line}_ekf_seed_{SEED}.mcap"


def drive(folder: Path, lines: Sequence[str] = LINES) -> None:
    """Drive lines of the demo under the EKF into a results folder; ends the program if that fails."""
    wanted = ('feedbacks=["ekf"]', "optimal=false", f"cases={','.join(lines)}", *STARTED)
    settings = [word for setting in wanted for word in ("--set", setting)]
    _hil("run", "wall_tracking", "--seed", str(SEED), *settings, "--out", str(folder))


def block(folder: Path, lines: Sequence[str] = LINES) -> str:
    """What `hil replay` prints of the recordings in a folder, as the page shows it."""
    return "".join(
        f"$ hil replay {SHOWN}/{recording(line)}\n" + _hil("replay", str(folder / recording(line)))
        for line in lines
    )


def with_block(page: str, text: str) -> str:
    """The page with its block of replayed recordings replaced."""
    changed, count = re.subn(r"(?<=```\n)\$ hil replay .*?(?=```)", lambda _: text, page, flags=re.DOTALL)
    if count != 1:
        raise SystemExit(f"{PAGE.name}: {count} blocks that begin with `$ hil replay`, expected one")
    return changed


def _hil(*words: str) -> str:
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        code = main(list(words))
    if code != 0:
        raise SystemExit(f"hil {' '.join(words)}: exit code {code}\n{said.getvalue()}")
    return said.getvalue()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        results = Path(scratch) / "run"
        drive(results)
        PAGE.write_text(with_block(PAGE.read_text(encoding="utf-8"), block(results)), encoding="utf-8")
    sys.exit(0)
