"""Kills benches and fan daemons at random moments and writes the table of docs/adhesion.md.

`python docs/make_kill_table.py` takes about half an hour: 100 kills of most kinds, in real time, while the
emulated robot is driven on its wall (`tests/adhesion/wall_trials.py`).
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import median

PAGE = Path(__file__).with_name("adhesion.md")
TRIALS = Path(__file__).resolve().parents[1] / "tests" / "adhesion"
KILLS, STRUCK, BOTH, SEED = 100, 50, 10, 1
HEAD = "| killed | times | without a command: median | at worst | what then |\n|---|---|---|---|---|\n"


def row(killed: str, gaps_s: Sequence[float], robot: str) -> str:
    """One line of the table."""
    figures = f"{1e3 * median(gaps_s):.0f} ms | {1e3 * max(gaps_s):.0f} ms"
    return f"| {killed} | {len(gaps_s)} | {figures} | {robot} |\n"


def table(kills: int = KILLS, both: int = BOTH, struck_kills: int = STRUCK) -> str:
    """Run all trials; the table of what they found."""
    sys.path.insert(0, str(TRIALS))
    import kills as trials
    import wall_trials
    from fan_on_the_wire import fan_on_the_wire

    from hil.bench.fan_commands import daemon_spec
    from hil.config.loading import load_bench

    rows = []
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_STATE_HOME"] = folder
        with wall_trials.robot_on_the_wall(SEED) as robot:
            path = robot.bench_file(Path(folder))
            struck = partial(wall_trials.benches_killed, faults=(wall_trials.HALF_BLIND,))
            runs = (
                ("bench, driving", wall_trials.benches_killed, kills),
                ("bench, driving with a [fault](faults.md#real-devices)", struck, struck_kills),
                ("fan daemon", wall_trials.daemons_killed, kills),
            )
            for killed, run, count in runs:
                found = run(robot, path, count, SEED)
                held = sum(kill.held for kill in found)
                rows.append(row(killed, [k.gap_s for k in found], f"held {held} times"))
            trials.end_daemon(daemon_spec(load_bench(str(path))))
        with fan_on_the_wire() as (fan, spec):
            pairs = trials.daemons_killed(fan, spec, kills, SEED)
            went_on = sum(kill.lowest_duty == trials.HELD_DUTY for kill in pairs)
            outcome = f"fan ran on {went_on} times: the bench took over"
            rows.append(row("fan daemon and standby", [k.gap_s for k in pairs], outcome))
            trials.end_daemon(spec)
            released_s = trials.all_killed(fan, spec, both, SEED)
            rows.append(row("all three", released_s, "the controller let go of the motor"))
            trials.end_daemon(spec)
    return HEAD + "".join(rows)


def with_table(page: str, text: str) -> str:
    """The page with its table of kills replaced."""
    changed, count = re.subn(r"\| killed \| .*?\n(?!\|)", lambda _: text, page, flags=re.DOTALL)
    if count != 1:
        raise SystemExit(f"{PAGE.name}: {count} tables of kills, expected one")
    return changed


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), table()), encoding="utf-8")
