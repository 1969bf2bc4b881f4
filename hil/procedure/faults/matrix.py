"""The matrix of a fault campaign as Markdown: devices and faults down, moments across."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hil.procedure.faults.cells import MOMENTS
from hil.procedure.faults.judging import CellVerdict
from hil.procedure.faults.quiet import quiet_table
from hil.vocabulary.files import write_text

_HEAD = """# Reliability

Every fault of every emulated device, at four moments of a climb of 12 cm on the shipped bench: while it
opens, in motion, where it ends, and for one second in motion. Written by

```sh
{command}
```

A cell passes when the robot is held within the limits (5 mm after its stop; what is said to be held moves by
less than 0.5 mm), when a stop names the device, when servos that come back are held again, when the recording
can be read, and when a run that ends well is wrong by less than three of its sigmas plus 5 mm. How it ended:
`on` the run went on, `stop` the robot was stopped, `none` the bench did not open. A star: the device is not
named anywhere, the run went on as if nothing had been; the last table says why. Of eight servos and four
encoders one of each kind stands for the others.

What the bench does not protect from: a fan whose power ends or whose controller restarts, a wall that gives
way, a computer that dies while servos restart, propellers that report nothing and get weaker bit by bit, and
errors that look like an honest robot, such as a camera that drifts down the wall by 3 mm/s
([wall.md](wall.md#what-stops-the-robot)). Independent fall protection stays the lab's.

{counts}
"""


def matrix_page(verdicts: Sequence[CellVerdict], command: str) -> str:
    """The whole page."""
    failed = [v for v in verdicts if v.why]
    quiet = sum(not v.told for v in verdicts)
    counts = (
        f"{len(verdicts)} cells, {len(failed)} failed, {quiet} passed without a word about the device."
        if verdicts else "No cells."
    )  # fmt: skip
    parts = [_HEAD.format(command=command, counts=counts)]
    for plant in dict.fromkeys(v.cell.plant for v in verdicts):
        mine = [v for v in verdicts if v.cell.plant == plant]
        seeds = sorted({v.cell.seed for v in mine})
        parts.append(f"\n## Plant `{plant}`, seeds {', '.join(map(str, seeds))}\n\n")
        parts.append("".join(_table(mine)))
    if failed:
        parts.append("\n## Failed\n\n| cell | why |\n|---|---|\n")
        parts += [f"| `{v.cell.name}` | {_plain('; '.join(v.why))} |\n" for v in failed]
    if quiet_lines := quiet_table(verdicts):
        parts.append("\n## Without a word\n\n| device | fault | moments | why |\n|---|---|---|---|\n")
        parts += quiet_lines
    return "".join(parts)


def _table(verdicts: Sequence[CellVerdict]) -> list[str]:
    moments = [m for m in (*MOMENTS, "random") if any(v.cell.moment == m for v in verdicts)]
    lines = [f"| device | fault | {' | '.join(moments)} |\n", "|---|---|" + "---|" * len(moments) + "\n"]
    for device, fault in dict.fromkeys((v.cell.device, v.cell.fault) for v in verdicts):
        mine = [v for v in verdicts if (v.cell.device, v.cell.fault) == (device, fault)]
        marks = [_mark([v for v in mine if v.cell.moment == m]) for m in moments]
        lines.append(f"| `{device}` | `{fault}` | {' | '.join(marks)} |\n")
    return lines


def _mark(verdicts: Sequence[CellVerdict]) -> str:
    """What stands in a cell of the table for its seeds."""
    if not verdicts:
        return ""
    bad = sum(bool(v.why) for v in verdicts)
    if bad:
        return f"**FAILED** {bad}/{len(verdicts)}"
    ends = sorted({"on" if v.ended == "went on" else "stop" if v.held else "none" for v in verdicts})
    return "/".join(ends) + ("" if all(v.told for v in verdicts) else " *")


def _plain(text: str) -> str:
    """Text that is safe in a table."""
    return " ".join(text.replace("|", "/").split())[:300]


def write_page(path: Path, verdicts: Sequence[CellVerdict], command: str) -> None:
    """Write the page."""
    write_text(path, matrix_page(verdicts, command))
