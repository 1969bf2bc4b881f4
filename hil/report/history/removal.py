"""Deletes results, but no files that `hil` did not write, no active runs, and no links.

Some files have fixed names. The names of recordings, figures and attachments come from the result or from
the journal of a run. A run inside the folder of another result is not part of it, unless that result is a
campaign or a commissioning that started this run.
"""

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.core.errors import DataError, reason_of
from hil.core.result_names import (
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
    LIVE_RECORDING,
    PLAN,
    REPORT,
    RESULT,
    ROWS,
    RUNS,
    SESSION,
    TRENDS,
)
from hil.report.history.index import (
    ACCEPTANCE,
    CAMPAIGN,
    COMMISSIONING,
    FAULTS,
    LIVE,
    OURS,
    RUN,
    Kept,
    in_use,
)
from hil.support.file_reading import json_object, read_json

FOLDERS = ("figures", "attachments", "recordings", RUNS, ROWS)
"""Folders that a run may have created and left empty."""
_MOTION = r"(line_[xy]|circle_c?cw|rotation_c?cw)"
_BEGUN = re.compile(r"\.hil-[0-9a-f]{8}")
"""Temporary file of a page, left by a killed process."""
_STAGE = re.compile(r"\d\d_[a-z0-9_]+(-\d+)?")
_NAMING = ("recording", "figure", "attach")
"""Kinds of journal entries that name a file."""
_PRECIOUS = ("calibration.toml", "bench_fragment.toml", "record.toml")
_SHOWN = 4


def _any_of(*names: str) -> str:
    """Return a pattern for these file names, also for their temporary files."""
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
_OF_AN_ACCEPTANCE = re.compile(_any_of(ACCEPTANCE_TABLE, ACCEPTANCE_PAGE))
_OF_A_SESSION = re.compile(_any_of(SESSION, LIVE_RECORDING))
_OF_FAULTS = re.compile(_any_of(FAULTS_TABLE, FAULTS_PAGE, FAULTS_MATRIX, FAULTS_CELLS, FAULTS_CELLS_BEFORE))


def all_files(folder: Path) -> list[str]:
    """Return every file and link below a folder as relative paths; links are not followed."""
    found = []
    for place, folders, files in os.walk(folder):
        links = [name for name in folders if (Path(place) / name).is_symlink()]
        found += [(Path(place) / name).relative_to(folder).as_posix() for name in (*files, *links)]
    return sorted(found)


def written(kept: Kept) -> list[str]:
    """Return the files that `hil` has written into the folder of a result, as relative paths.

    The files that identify the folder as a result come last, so that an interrupted removal can be repeated.
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
        SESSION,
    )
    own = [name for name in _own(kept, there) if not (folder / name).is_symlink()]
    own += [name for name in there if _BEGUN.fullmatch(name) and not (folder / name).is_symlink()]
    return sorted(own, key=lambda name: (name in marks, name))


def _own(kept: Kept, there: list[str]) -> Iterator[str]:
    if kept.kind == ACCEPTANCE:
        yield from filter(_OF_AN_ACCEPTANCE.fullmatch, there)
    elif kept.kind == LIVE:
        yield from filter(_OF_A_SESSION.fullmatch, there)
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
    """Yield the files of a run in a subfolder, without those of another run below it."""
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
    """Return the files that a run lists in its result, and in its journal, which covers earlier attempts."""
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


@dataclass(frozen=True)
class Loss:
    """Files that the deletion of a result removes, and those that it leaves.

    Attributes:
        kept: the result.
        files: files to delete, relative to its folder.
        size_bytes: size of these files.
        precious: names of files on which other results may depend.
        stays: files that `hil` has not written, relative to its folder.
    """

    kept: Kept
    files: tuple[str, ...]
    size_bytes: int
    precious: tuple[str, ...]
    stays: tuple[str, ...] = ()

    def in_words(self) -> str:
        """Return one line for the question before the deletion."""
        what = f"{self.kept.name}: {self.kept.what} {self.kept.verdict or self.kept.kind}"
        part = f", part of {self.kept.within}" if self.kept.within else ""
        held = f", with {', '.join(self.precious)}" if self.precious else ""
        size = f"{len(self.files)} files, {self.size_bytes / 1e6:.1f} MB"
        return "; ".join(filter(None, (f"{what}, {size}{held}{part}", self.stays_in_words())))

    def stays_in_words(self) -> str:
        """Return what is left of the folder and why; empty if all is deleted."""
        if not self.stays:
            return ""
        few = ", ".join(self.stays[:_SHOWN]) + (", ..." if len(self.stays) > _SHOWN else "")
        if len(self.stays) == 1:
            return f"1 file that is not part of it stays in {self.kept.folder}: {few}"
        return f"{len(self.stays)} files that are not part of it stay in {self.kept.folder}: {few}"


def loss(root: Path, kept: Kept) -> Loss:
    """Check that a result may be deleted; return what would be lost.

    Raises:
        DataError: the result is foreign, still in use, or outside the folder of results.
    """
    folder = kept.folder
    if kept.kind not in OURS:
        raise DataError(str(folder), f"is not deleted: {kept.why}", remedy="delete it by hand if it is yours")
    if folder.is_symlink() or not folder.resolve().is_relative_to(root.resolve()):
        raise DataError(str(folder), "is not deleted: it is a link to somewhere else")
    if folder.resolve() == root.resolve():
        raise DataError(
            str(folder),
            "is not deleted: it is the folder of results itself",
            remedy="name the folder above it with --in",
        )
    if in_use(folder):
        raise DataError(
            str(folder), "is not deleted: a run is still writing to it", remedy="wait for its end"
        )
    own = written(kept)
    precious = {n.rpartition("/")[2] for n in own if n.endswith((".mcap", *_PRECIOUS))}
    size_bytes = sum((folder / name).lstat().st_size for name in own)
    stays = tuple(sorted(set(all_files(folder)).difference(own)))
    return Loss(kept, tuple(own), size_bytes, tuple(sorted(precious)[:6]), stays)


def delete(losses: Sequence[Loss]) -> None:
    """Delete the files of each loss, and the folders that are then empty.

    Raises:
        DataError: a file cannot be deleted; names this file. The files before it are deleted.
    """
    for item in losses:
        folder = item.kept.folder
        for name in item.files:
            try:
                (folder / name).unlink(missing_ok=True)
            except OSError as error:
                raise DataError(str(folder / name), f"cannot be deleted ({reason_of(error)})") from None
        for place in _emptied(item):
            with suppress(OSError):  # the folder holds files of another program
                os.rmdir(place)


def _emptied(item: Loss) -> Iterator[Path]:
    """Yield the folders that `hil` created for its files, the deepest first, the result's folder last."""
    folder = item.kept.folder
    held = {place for name in item.files for place in (folder / name).parents if place != folder}
    within = {place for place in held if place.is_relative_to(folder)} | {folder / name for name in FOLDERS}
    yield from sorted(within, key=lambda place: len(place.parts), reverse=True)
    yield folder
