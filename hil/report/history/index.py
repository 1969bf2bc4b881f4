"""Lists the contents of a folder of results: runs, live sessions, campaigns, commissionings and others.

A folder of results may hold any files. An entry that is not a readable result is listed with the reason: an
unfinished run, the result of another version, a page or a file from another source.
"""

import fcntl
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from html import unescape
from pathlib import Path
from typing import Any

from hil.core.errors import DataError, reason_of
from hil.core.result_names import (
    ACCEPTANCE_TABLE,
    CAMPAIGN_TABLE,
    COMMISSIONING_TABLE,
    FAULTS_CELLS,
    FAULTS_TABLE,
    JOURNAL,
    PASSED,
    PLAN,
    RESULT,
    RESULT_SCHEMA,
    SESSION,
    end_of_session,
)
from hil.report.result_reader import read_result
from hil.support.file_reading import json_object, read_json

RUN, CAMPAIGN, COMMISSIONING, ACCEPTANCE = "run", "campaign", "commissioning", "acceptance"
FAULTS, LIVE, UNFINISHED, FOREIGN = "faults", "live", "unfinished", "foreign"
OURS = (RUN, CAMPAIGN, COMMISSIONING, ACCEPTANCE, FAULTS, LIVE, UNFINISHED)
"""Kinds that `hil` writes, and may delete."""
_SIGNALS = {"SIGINT": "Ctrl-C or STOP", "SIGTERM": "STOP or another program", "SIGHUP": "closed terminal"}
_DEEPEST = 8
_MOST_LINE_BYTES = 4 << 20
_PAGE_BYTES = 1 << 16


@dataclass(frozen=True)
class Kept:
    """One entry of a folder of results.

    Attributes:
        folder: folder of the entry.
        name: path of that folder, relative to the folder of results; shown to the user.
        kind: `run`, `campaign`, `commissioning`, `acceptance`, `faults`, `live`, `unfinished`, `foreign`.
        what: name of the procedure, or of the command of a live session; title of a page.
        when: start time; if unknown, time of the last change.
        bench: name of the bench.
        where: `hardware`, `emulated`, or which devices were emulated.
        verdict: `PASS`, `FAIL` and so on; empty without a verdict.
        why: problem or contents of the entry; empty for a run.
        result: validated `result.json` of a run.
        within: name of the campaign or commissioning that contains it; empty for none.
        of_campaign: True if `within` is a campaign.
    """

    folder: Path
    name: str
    kind: str
    what: str
    when: datetime
    bench: str = ""
    where: str = ""
    verdict: str = ""
    why: str = ""
    result: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)
    within: str = ""
    of_campaign: bool = False


def find_results(root: Path) -> list[Kept]:
    """Return all entries of a folder of results, the latest first. Symbolic links are not followed.

    Raises:
        DataError: the folder does not exist or cannot be read.
    """
    if not root.is_dir():
        what = "is a file" if root.exists() else "there is no such folder"
        raise DataError(
            str(root),
            what,
            expected="a folder of results",
            remedy="name one with --in, or run a procedure first",
        )
    found: dict[Path, Kept] = {}
    for folder, files in _folders(root):
        owner = next((found[p] for p in folder.parents if p in found and p != root), None)
        if owner is not None and owner.kind not in (CAMPAIGN, COMMISSIONING):
            continue  # figures and attachments of that result
        kept = _look(root, folder, files)
        if kept is not None and owner is not None:
            kept = replace(kept, within=owner.name, of_campaign=owner.kind == CAMPAIGN)
        if kept is not None:
            found[folder] = kept
    return sorted(found.values(), key=lambda k: (k.when, k.name), reverse=True)


def _folders(root: Path) -> Iterator[tuple[Path, list[str]]]:
    """Yield folders top down with their files, each before its subfolders."""

    def refused(error: OSError) -> None:
        if Path(error.filename or "") == root:
            raise DataError(str(root), f"cannot be read ({reason_of(error)})")

    for place, folders, files in os.walk(root, onerror=refused):
        depth = len(Path(place).relative_to(root).parts)
        folders[:] = sorted(folders) if depth < _DEEPEST else []
        yield Path(place), files


def _look(root: Path, folder: Path, files: Sequence[str]) -> Kept | None:
    """Return the entry of a folder; None if it only contains other folders."""
    name = folder.relative_to(root).as_posix()
    for mark, reader in _READERS.items():
        if mark in files and (folder / mark).is_file():
            return reader(folder, name)
    pages = sorted(f for f in files if f.endswith(".html") and (folder / f).is_file())
    if not pages or folder == root:
        return None
    page = _foreign(folder, name, pages[0], f"pages that belong to no run: {', '.join(pages[:3])}")
    return replace(page, what=_title(folder / pages[0]) or pages[0])


def _foreign(folder: Path, name: str, file: str, why: str) -> Kept:
    return Kept(folder, name, FOREIGN, "", _changed(folder / file), why=why)


def _run(folder: Path, name: str) -> Kept:
    try:
        tree = read_result(folder)
    except DataError as error:
        return _foreign(folder, name, RESULT, _not_ours(folder, error))
    return Kept(
        folder,
        name,
        RUN,
        tree["procedure"],
        _moment(tree["started"]) or _changed(folder / RESULT),
        bench=tree["bench"] or "",
        where=_where(tree),
        verdict=tree["verdict"],
        result=tree,
    )


def _not_ours(folder: Path, error: DataError) -> str:
    """Return why this version cannot read a `result.json`."""
    tree, problem = _object(folder / RESULT)
    schema = tree.get("schema")
    if isinstance(schema, int) and schema != RESULT_SCHEMA and "procedure" in tree:
        return f"written by another version of hil (schema {schema}; this one reads {RESULT_SCHEMA})"
    return problem or error.message.removeprefix(f"{folder / RESULT}: ")


def _where(tree: Mapping[str, Any]) -> str:
    if tree["virtual_time"]:
        return "emulated"
    emulated = ", ".join(tree["emulated"])
    return f"real time, emulated: {emulated}" if emulated else "hardware"


def _campaign(folder: Path, name: str) -> Kept:
    tree, problem = _object(folder / CAMPAIGN_TABLE)
    what, planned = tree.get("procedure"), tree.get("planned", tree.get("cases"))
    if problem or not isinstance(what, str):
        return _foreign(folder, name, CAMPAIGN_TABLE, problem or f"{CAMPAIGN_TABLE} is of no campaign")
    return Kept(
        folder,
        name,
        CAMPAIGN,
        what,
        _changed(folder / CAMPAIGN_TABLE),
        bench=str(tree.get("bench", "")),
        where="emulated",
        verdict=str(tree.get("verdict", "")),
        why=f"{tree.get('cases')} runs" + (f" of {planned}" if planned != tree.get("cases") else ""),
    )


def _commissioning(folder: Path, name: str) -> Kept:
    tree, problem = _object(folder / COMMISSIONING_TABLE)
    done, options = tree.get("done"), tree.get("options")
    if problem or not isinstance(done, dict):
        return _foreign(
            folder, name, COMMISSIONING_TABLE, problem or "commission.json is of no commissioning"
        )
    verdicts = {k: str(v.get("verdict", "")) for k, v in done.items() if isinstance(v, dict)}
    bad = next(((k, v) for k, v in verdicts.items() if v not in (*PASSED, "SKIPPED")), None)
    return Kept(
        folder,
        name,
        COMMISSIONING,
        "commissioning",
        _changed(folder / COMMISSIONING_TABLE),
        bench=str(options.get("bench", "")) if isinstance(options, dict) else "",
        verdict=bad[1] if bad else "",
        why=f"{len(verdicts)} procedures" + (f", stopped at {bad[0]}" if bad else ""),
    )


def _acceptance(folder: Path, name: str) -> Kept:
    """Return the entry of an acceptance: a page to sign, and its data."""
    tree, problem = _object(folder / ACCEPTANCE_TABLE)
    verdict, stages, devices = tree.get("verdict"), tree.get("stages"), tree.get("devices")
    if problem or not (isinstance(verdict, str) and isinstance(stages, list) and isinstance(devices, dict)):
        return _foreign(folder, name, ACCEPTANCE_TABLE, problem or "accept.json is of no acceptance")
    real = any(isinstance(d, dict) and d.get("backend") == "real" for d in devices.values())
    whys = [f"{s.get('name')}: {s['why']}" for s in stages if isinstance(s, dict) and s.get("why")]
    when = _moment(tree.get("began")) or _changed(folder / ACCEPTANCE_TABLE)
    return Kept(
        folder,
        name,
        ACCEPTANCE,
        "acceptance",
        when,
        bench=str(tree.get("bench", "")),
        where="hardware" if real else "emulated",
        verdict=verdict,
        why="; ".join(whys),
    )


def _faults(folder: Path, name: str) -> Kept:
    """Return the entry of a fault campaign."""
    tree, problem = _object(folder / FAULTS_TABLE)
    verdict, cells, failed = tree.get("verdict"), tree.get("cells"), tree.get("failed")
    if problem or not (isinstance(verdict, str) and isinstance(cells, int) and isinstance(failed, list)):
        return _foreign(folder, name, FAULTS_TABLE, problem or f"{FAULTS_TABLE} is of no fault campaign")
    when = _moment(tree.get("began")) or _changed(folder / FAULTS_TABLE)
    planned = tree.get("planned", cells)
    of = f" of {planned}" if planned != cells else ""
    return Kept(
        folder,
        name,
        FAULTS,
        "fault campaign",
        when,
        bench=str(tree.get("bench", "")),
        where="emulated",
        verdict=verdict,
        why=f"{cells} runs with faults{of}, {len(failed)} failed",
    )


def _session(folder: Path, name: str) -> Kept:
    """Return the entry of a live session."""
    tree, problem = _object(folder / SESSION)
    command, when = tree.get("command"), _moment(tree.get("began"))
    if problem or not isinstance(command, str) or when is None:
        return _foreign(folder, name, SESSION, problem or f"{SESSION} is of no live session")
    emulated, held = tree.get("emulated"), tree.get("held")
    devices = ", ".join(map(str, emulated)) if isinstance(emulated, list) else ""
    where = f"real time, emulated: {devices}" if tree.get("real") else "real time, emulated"
    why, verdict, faults = "it still runs, or was killed", "", tree.get("faults")
    if isinstance(held, dict):
        ended, state = str(tree.get("ended")), str(held.get("state"))
        why, verdict = f"ended by: {_SIGNALS.get(ended, ended)}; {state}", end_of_session(ended, state)
    if isinstance(faults, list) and faults:
        why = f"with {', '.join(map(str, faults))}; {why}"
    return Kept(
        folder,
        name,
        LIVE,
        " ".join(filter(None, (command, str(tree.get("moves", ""))))),
        when,
        bench=str(tree.get("bench", "")),
        where=where if devices else "hardware",
        verdict=verdict,
        why=why,
    )


def _unfinished_faults(folder: Path, name: str) -> Kept:
    """Return the entry of an unfinished fault campaign."""
    why = "a fault campaign without its table; --resume continues it"
    return Kept(folder, name, UNFINISHED, "fault campaign", _changed(folder / FAULTS_CELLS), why=why)


def _unfinished(folder: Path, name: str) -> Kept:
    """Return the entry of a run without a result: still running or killed."""
    path = folder / JOURNAL
    try:
        with path.open("rb") as file:
            head = json_object(file.readline(_MOST_LINE_BYTES))
    except (OSError, ValueError) as error:
        return _foreign(folder, name, JOURNAL, f"journal.jsonl cannot be read ({error})")
    config, what = head.get("config"), head.get("procedure")
    if head.get("kind") != "run" or not isinstance(what, str):
        return _foreign(folder, name, JOURNAL, "journal.jsonl is not the journal of a run")
    state = "still running" if in_use(folder) else "struck down before its result; --resume continues it"
    return Kept(
        folder,
        name,
        UNFINISHED,
        what,
        _moment(head.get("started")) or _changed(path),
        bench=str(config.get("name", "")) if isinstance(config, dict) else "",
        why=state,
    )


def _unfinished_campaign(folder: Path, name: str) -> Kept | None:
    tree, _ = _object(folder / PLAN)
    what = tree.get("procedure")
    if not isinstance(what, str):
        return None
    why = "a campaign without its table; --resume continues it"
    return Kept(folder, name, UNFINISHED, what, _changed(folder / PLAN), why=why)


_READERS: Mapping[str, Callable[[Path, str], Kept | None]] = {
    RESULT: _run,
    CAMPAIGN_TABLE: _campaign,
    COMMISSIONING_TABLE: _commissioning,
    ACCEPTANCE_TABLE: _acceptance,
    FAULTS_TABLE: _faults,
    SESSION: _session,
    JOURNAL: _unfinished,
    PLAN: _unfinished_campaign,
    FAULTS_CELLS: _unfinished_faults,
}
"""Functions that read a folder by a file name in it, in order of priority."""


def in_use(folder: Path) -> bool:
    """Whether a run is active in a folder or below it, that is, holds a lock on its journal."""
    for journal in folder.rglob(JOURNAL):
        try:
            with journal.open("rb") as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            continue
    return False


def _object(path: Path) -> tuple[dict[str, Any], str]:
    """Return a JSON object, and why it could not be read."""
    try:
        tree = read_json(path)
    except DataError as error:
        return {}, str(error).removeprefix(f"{path}: ")
    return (tree, "") if isinstance(tree, dict) else ({}, f"{path.name} is not a JSON object")


def _title(page: Path) -> str:
    try:
        with page.open("rb") as file:
            text = file.read(_PAGE_BYTES).decode("utf-8", "replace")
    except OSError:
        return ""
    found = re.search(r"<title[^>]*>(.*?)</title", text, re.DOTALL | re.IGNORECASE)
    return " ".join(unescape(found[1]).split())[:80] if found else ""


def _moment(text: object) -> datetime | None:
    """Parse a date and time, ISO 8601; without an offset it is local time."""
    try:
        return datetime.fromisoformat(str(text)).astimezone(timezone.utc)
    except (ValueError, OverflowError):
        return None


def _changed(path: Path) -> datetime:
    try:
        return datetime.fromtimestamp(path.stat().st_mtime, timezone.utc)
    except (OSError, ValueError, OverflowError):
        return datetime.fromtimestamp(0, timezone.utc)
