"""Kills benches and keepers at random moments and writes the table of docs/adhesion.md.

`python docs/make_kill_table.py` takes about ten minutes: 100 kills of each kind, in real time, at a fan on a
CAN bus of loopback (`tests/adhesion/kills.py`).
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import median

PAGE = Path(__file__).with_name("adhesion.md")
TRIALS = Path(__file__).resolve().parents[1] / "tests" / "adhesion"
KILLS, BOTH, SEED = 100, 10, 1
HEAD = "| killed | times | without a command: median | at worst | the fan |\n|---|---|---|---|---|\n"


def row(killed: str, gaps_s: Sequence[float], fan: str) -> str:
    """One line of the table."""
    figures = f"{1e3 * median(gaps_s):.0f} ms | {1e3 * max(gaps_s):.0f} ms"
    return f"| {killed} | {len(gaps_s)} | {figures} | {fan} |\n"


def table(kills: int = KILLS, both: int = BOTH) -> str:
    """Run all trials; the table of what they found."""
    sys.path.insert(0, str(TRIALS))
    import kills as trials
    from fan_on_the_wire import fan_on_the_wire

    rows = []
    with tempfile.TemporaryDirectory() as folder, fan_on_the_wire() as (fan, spec):
        os.environ["XDG_STATE_HOME"] = folder
        for killed, run in (("bench", trials.bench_killed), ("keeper", trials.keeper_killed)):
            found = run(fan, spec, kills, SEED)
            held = sum(kill.lowest_duty == trials.HELD_DUTY for kill in found)
            rows.append(row(killed, [k.gap_s for k in found], f"ran on at its set-point {held} times"))
        released_s = trials.both_killed(fan, spec, both, SEED)
        rows.append(row("both", released_s, "was let go of by its controller"))
        trials.end_keeper(spec)
    return HEAD + "".join(rows)


def with_table(page: str, text: str) -> str:
    """The page with its table of kills replaced."""
    changed, count = re.subn(r"\| killed \| .*?\n(?!\|)", lambda _: text, page, flags=re.DOTALL)
    if count != 1:
        raise SystemExit(f"{PAGE.name}: {count} tables of kills, expected one")
    return changed


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), table()), encoding="utf-8")
