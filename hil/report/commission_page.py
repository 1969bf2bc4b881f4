"""The page of a commissioning: accuracy of the robot, its known parameters, and how they were measured.

Also the page of a record alone.
"""

from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any

from markupsafe import Markup

from hil.config.robot_record import RobotRecord
from hil.core.errors import ConfigError
from hil.core.result_names import COMMISSIONING_PAGE
from hil.report.ablation_figure import EVERYTHING, NOTHING, ablation_figure
from hil.report.page_figures import figure_image, save_figure
from hil.report.page_formats import duration, environment
from hil.report.robot_table import part_rows
from hil.support.atomic_files import put_whole, refused, write_text

FIGURE = "ablation.svg"


def write_commission_page(folder: Path, summary: Mapping[str, Any], bench: str, now: str, seed: int) -> Path:
    """Write `commission.html`; return its path.

    Args:
        folder: folder of the commissioning.
        summary: output of `hil commission --json`.
        bench: name of the bench.
        now: date and time, ISO 8601.
        seed: seed of the emulated world.

    Raises:
        DataError: the page cannot be written.
    """
    wall = summary["wall"]
    page = (
        environment()
        .get_template("commission.html")
        .render(
            summary=summary,
            bench=bench,
            now=now,
            seed=seed,
            headline=headline(wall),
            figure=_figure(folder, wall) if wall else None,
            parts=_parts(Path(summary["robot"]), now),
            stages=[s | {"took": duration(s.get("seconds"))} for s in summary["stages"]],
        )
    )
    try:
        put_whole(folder / COMMISSIONING_PAGE, page.encode("utf-8", "backslashreplace"))
    except OSError as error:
        raise refused(folder / COMMISSIONING_PAGE, error) from None
    return folder / COMMISSIONING_PAGE


def write_robot_page(path: Path, record: RobotRecord, today: date) -> Path:
    """Write the page of a record; return its path.

    Raises:
        ConfigError, DataError: the record cannot be read, or the page cannot be written.
    """
    file = record.read()
    parts = part_rows(file, today)
    page = (
        environment()
        .get_template("robot.html")
        .render(
            file=file,
            parts=parts,
            sentence=_known(parts),
            history=record.history(),
            folder=str(record.folder),
        )
    )
    return write_text(path, page)


def _known(parts: Sequence[Mapping[str, Any]]) -> str:
    """Return a sentence: how many parts of the robot are known, and which are out of date."""
    known = [row for row in parts if row["known"]]
    old = [row["title"] for row in known if row["out_of_date"]]
    text = f"{len(known)} of {len(parts)} parts of the robot are known"
    return f"{text}; out of date: {', '.join(old)}." if old else f"{text}, and none of them is out of date."


def headline(wall: Mapping[str, Any]) -> str:
    """Return one sentence: the improvement by the commissioning."""
    if NOTHING not in wall or EVERYTHING not in wall:
        return ""
    ways = []
    for case, words in (("x_line", "up"), ("y_line", "across")):
        if case in wall[NOTHING] and case in wall[EVERYTHING]:
            before, after = (1e3 * wall[name][case]["end_m"] for name in (NOTHING, EVERYTHING))
            ways.append(f"{after:.1f} mm from its goal {words} the wall ({before:.1f} mm with nothing known)")
    return "The robot ends " + " and ".join(ways) + "." if ways else ""


def _figure(folder: Path, wall: Mapping[str, Any]) -> Markup:
    path = save_figure(ablation_figure(wall), folder / FIGURE)
    return figure_image(path, "What is known, and where the robot ends")


def _parts(folder: Path, now: str) -> list[dict[str, Any]]:
    record = RobotRecord(folder)
    try:
        return part_rows(record.read(), date.fromisoformat(now[:10])) if record.exists() else []
    except ConfigError:
        return []
