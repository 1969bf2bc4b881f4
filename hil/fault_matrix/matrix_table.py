"""Results of a fault campaign: matrix (devices and faults in rows, moments in columns), page and JSON."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.core.result_names import FAULTS_PAGE, FAULTS_TABLE
from hil.fault_matrix.movement_bounds import (
    MOST_ASTRAY_M,
    MOST_NAMED,
    MOST_OFF_M,
    SIGMAS,
    SLACK_M,
    STILL_M,
    WATCHED_S,
)
from hil.report.page_formats import environment
from hil.support.atomic_files import put_whole, refused, write_text

_HEAD = """# Reliability

Faults of the emulated devices during a climb of 12 cm on the shipped bench. There are four moments: while it
opens, in motion, where it ends, and for one second in motion. These are the cells that this command judges:

```sh
{command}
```

A cell passes if a stop names the faulty device and no more than {most_named} kinds of devices, the robot
moves no farther than is promised for its class of faults, a robot that was reported HELD moves by less than
{still_mm:g} mm in the {watched_s:g} s after the bench has closed, servos that come back are held again, the
recording can be read, the robot is never {astray_mm:g} mm off its reference, and a run that reaches its end
measures that end right or marks it, names the device if the fault had an effect, and has an estimate wrong by
less than {sigmas:g} of its sigmas plus {slack_mm:g} mm, and by less than {most_mm:g} mm. A bench that does
not open is observed like any other. How it ended: `on` the run went on, `stop` the robot was stopped, `none`
the bench did not open. A star: no stop or event names the device, and the run went on unchanged; the last
table gives the reason. Of eight servos and four encoders one of each kind represents the others.

What the bench does not protect from: a fan that loses power or whose controller restarts, propellers that
lose power or cannot decode their commands, a wall that gives way, a computer that dies while servos
restart, and errors that look like normal motion, such as a camera that drifts down the wall by 3 mm/s
([wall.md](wall.md#what-stops-the-robot)). The lab has to provide independent fall protection.

{counts}
"""


def matrix_page(summary: Mapping[str, Any]) -> str:
    """Return the page as Markdown, from the result of `hil.fault_matrix.summary`."""
    counts = (
        f"{summary['cells']} cells, {len(summary['failed'])} failed, "
        f"{summary['quiet_cells']} passed without a report of the device."
        if summary["cells"]
        else "No cells."
    )
    if summary["cells"] < summary["planned"]:
        counts += (
            f" Ended early: {summary['planned']} cells were requested; `--resume` goes on with the others."
        )
    parts = [
        _HEAD.format(
            command=summary["command"],
            counts=counts,
            watched_s=WATCHED_S,
            sigmas=SIGMAS,
            still_mm=1e3 * STILL_M,
            slack_mm=1e3 * SLACK_M,
            most_mm=1e3 * MOST_OFF_M,
            most_named=MOST_NAMED,
            astray_mm=1e3 * MOST_ASTRAY_M,
        )
    ]
    if summary["classes"]:
        parts.append("\n## What is promised, and the worst that was measured\n\n")
        parts.append("| faults of | promised after the stop | measured | cells | failed |\n")
        parts.append("|---|---|---|---|---|\n")
    parts += [
        f"| {c['name']} | {c['promise']} | {c['measured']} | {c['cells']} | {c['failed']} |\n"
        for c in summary["classes"]
    ]
    for plant in summary["plants"]:
        parts.append(f"\n## Plant `{plant['plant']}`, seeds {', '.join(map(str, plant['seeds']))}\n\n")
        parts += _table(plant)
    if summary["failed"]:
        parts.append("\n## Failed\n\n| cell | why |\n|---|---|\n")
        parts += [f"| `{f['cell']}` | {_plain(f['why'])} |\n" for f in summary["failed"]]
    if summary["quiet"]:
        parts.append("\n## Not reported\n\n| device | fault | moments | why |\n|---|---|---|---|\n")
    parts += [
        f"| `{q['device']}` | `{q['fault']}` | {', '.join(q['moments'])} | {q['why']} |\n"
        for q in summary["quiet"]
    ]
    return "".join(parts)


def _table(plant: Mapping[str, Any]) -> list[str]:
    moments = plant["moments"]
    lines = [f"| device | fault | {' | '.join(moments)} | how it was left |\n"]
    lines.append("|---|---|" + "---|" * len(moments) + "---|\n")
    for row in plant["rows"]:
        marks = " | ".join(f"**{m}**" if m.startswith("FAILED") else m for m in row["marks"])
        lines.append(f"| `{row['device']}` | `{row['fault']}` | {marks} | {row['measured']} |\n")
    return lines


def _plain(text: str) -> str:
    """Escape a text for a cell of a Markdown table."""
    return " ".join(text.replace("|", "/").split())[:300]


def write_page(path: Path, summary: Mapping[str, Any]) -> None:
    """Write the matrix."""
    write_text(path, matrix_page(summary))


def write_faults(folder: Path, summary: Mapping[str, Any]) -> Path:
    """Write `faults.html` and `faults.json`; returns the path of the page.

    Args:
        folder: folder of the campaign; must exist.
        summary: result of `hil.fault_matrix.summary`, with `began`, ISO 8601.

    Raises:
        DataError: a file cannot be written.
    """
    page = environment().get_template("faults.html").render(summary=summary)
    data = json.dumps(summary, indent=2, allow_nan=False) + "\n"
    for name, text in ((FAULTS_PAGE, page), (FAULTS_TABLE, data)):
        try:
            put_whole(folder / name, text.encode("utf-8", "backslashreplace"))
        except OSError as error:
            raise refused(folder / name, error) from None
    return folder / FAULTS_PAGE
