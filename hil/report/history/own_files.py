"""Lists the files in the folder of a result that `hil` has written and deletes with it.

Some have fixed names. The others are named by the result itself, or by the journal of a run: recordings,
figures, attachments. A run in the folder of another one belongs to neither, unless that is a campaign or a
commissioning which has begun it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hil.core.errors import DataError
from hil.core.result_files import (
    ACCEPTANCE_PAGE,
    ACCEPTANCE_TABLE,
    CAMPAIGN_CSV,
    CAMPAIGN_PAGE,
    CAMPAIGN_TABLE,
    COMMISSIONING_PAGE,
    COMMISSIONING_TABLE,
    COMPARISON,
    FAULTS_CELLS,
    FAULTS_CELLS_BEFORE,
    FAULTS_MATRIX,
    FAULTS_PAGE,
    FAULTS_TABLE,
    JOURNAL,
    JUNIT,
    PLAN,
    REPORT,
    RESULT,
    ROWS,
    RUNS,
    TRENDS,
)
from hil.report.history.index import ACCEPTANCE, CAMPAIGN, COMMISSIONING, FAULTS, RUN, Kept
from hil.support.file_reading import json_object, read_json

FOLDERS = ("figures", "attachments", "recordings", RUNS, ROWS)
"""Folders that may have been made and left empty."""
_MOTION = r"(line_[xy]|circle_c?cw|rotation_c?cw)"


def _any_of(*names: str) -> str:
    """A pattern of these names, whole or not finished."""
    return f"({'|'.join(map(re.escape, names))})(\\.part)?"


_OF_A_RUN = re.compile(
    _any_of(RESULT, JUNIT, REPORT, COMPARISON, JOURNAL)
    + r"|recording(_[a-z0-9_]+)?(-\d+)?\.mcap|figures/\d\d_[a-z0-9_]+\.svg|calibration_round_\d+\.toml"
    rf"|recordings/(round_\d+|validation)/{_MOTION}_\d+\.csv"
)
_OF_A_CAMPAIGN = re.compile(_any_of(PLAN, CAMPAIGN_TABLE, CAMPAIGN_CSV, CAMPAIGN_PAGE, COMPARISON, TRENDS))
_OF_A_COMMISSIONING = re.compile(
    _any_of(COMMISSIONING_TABLE, COMMISSIONING_PAGE, TRENDS)
    + r"|robot/(record|history/v\d{4,})\.toml(\.part)?|ablation\.svg"
    r"|robot/files/[^/]+-[0-9a-f]{12}(\.[^/.]+)?(\.part)?"
)
_BEGUN = re.compile(r"\.hil-[0-9a-f]{8}")
"""A page that a process was struck down over."""
_STAGE = re.compile(r"\d\d_[a-z0-9_]+(-\d+)?")
_OF_AN_ACCEPTANCE = re.compile(_any_of(ACCEPTANCE_TABLE, ACCEPTANCE_PAGE))
_OF_FAULTS = re.compile(_any_of(FAULTS_TABLE, FAULTS_PAGE, FAULTS_MATRIX, FAULTS_CELLS, FAULTS_CELLS_BEFORE))
_NAMING = ("recording", "figure", "attach")
"""Entries of a journal that name a file."""


def all_files(folder: Path) -> list[str]:
    """Every file and link below a folder, as paths within it; links are not followed."""
    found = []
    for place, folders, files in os.walk(folder):
        links = [name for name in folders if (Path(place) / name).is_symlink()]
        found += [(Path(place) / name).relative_to(folder).as_posix() for name in (*files, *links)]
    return sorted(found)


def written(kept: Kept) -> list[str]:
    """What `hil` has written into the folder of a result, as paths within it.

    What makes the folder a result comes last: an interrupted removal can be repeated.
    """
    folder, there = kept.folder, all_files(kept.folder)
    marks = (
        RESULT,
        JOURNAL,
        CAMPAIGN_TABLE,
        PLAN,
        COMMISSIONING_TABLE,
        ACCEPTANCE_TABLE,
        FAULTS_TABLE,
        FAULTS_CELLS,
    )
    own = [name for name in _own(kept, there) if not (folder / name).is_symlink()]
    own += [name for name in there if _BEGUN.fullmatch(name) and not (folder / name).is_symlink()]
    return sorted(own, key=lambda name: (name in marks, name))


def _own(kept: Kept, there: list[str]) -> Iterator[str]:
    if kept.kind == ACCEPTANCE:
        yield from filter(_OF_AN_ACCEPTANCE.fullmatch, there)
    elif kept.kind == FAULTS or (FAULTS_CELLS in there and JOURNAL not in there):
        yield from filter(_OF_FAULTS.fullmatch, there)
    elif kept.kind == COMMISSIONING:
        yield from filter(_OF_A_COMMISSIONING.fullmatch, there)
        for place in {name.partition("/")[0] for name in there if "/" in name}:
            if _STAGE.fullmatch(place):
                yield from _of_a_run(kept.folder, place, there)
    elif kept.kind == CAMPAIGN or (kept.kind != RUN and JOURNAL not in there):
        yield from filter(_OF_A_CAMPAIGN.fullmatch, there)
        cases = _object(kept.folder / PLAN).get("cases")
        for case in {str(case) for case in cases} if isinstance(cases, list) else ():
            yield from (n for n in there if n in (f"{ROWS}/{case}.parquet", f"{ROWS}/{case}.parquet.part"))
            yield from _of_a_run(kept.folder, f"{RUNS}/{case}", there)
    else:
        yield from _of_a_run(kept.folder, "", there)


def _of_a_run(folder: Path, place: str, there: list[str]) -> Iterator[str]:
    """What a run has written into a folder within another; nothing of a run below it."""
    within = f"{place}/" if place else ""
    inside = [name.removeprefix(within) for name in there if name.startswith(within)]
    runs = {name.rpartition("/")[0] for name in inside if name.endswith((f"/{RESULT}", f"/{JOURNAL}"))}
    named = _named(folder / place)
    for name in inside:
        if any(name.startswith(f"{run}/") for run in runs):
            continue
        if name in named or _OF_A_RUN.fullmatch(name):
            yield within + name


def _named(folder: Path) -> set[str]:
    """Files that a run names as its own: in its result, and in its journal, which knows earlier attempts."""
    result = _object(folder / RESULT)
    names = _list(result, "recordings")
    for entry in _list(result, "figures") + _list(result, "attachments"):
        names += [entry.get("path")] if isinstance(entry, dict) else []
    try:
        with (folder / JOURNAL).open("rb") as file:
            for line in file:
                if b'"path"' in line:
                    names.append(_named_by(line))
    except OSError:
        pass
    return {name for name in names if isinstance(name, str)}


def _named_by(line: bytes) -> Any:
    try:
        entry = json_object(line)
    except ValueError:
        return None
    return entry.get("path") if entry.get("kind") in _NAMING else None


def _object(path: Path) -> dict[str, Any]:
    try:
        tree = read_json(path)
    except DataError:
        return {}
    return tree if isinstance(tree, dict) else {}


def _list(tree: dict[str, Any], key: str) -> list[Any]:
    value = tree.get(key)
    return list(value) if isinstance(value, list) else []
