"""The journal of a run: one JSON line per event, written to disk before the run continues.

A killed run can be resumed from its journal. An incomplete last line is dropped; any other damage is
an error, because a run resumed from a damaged journal would have wrong results.
"""

import fcntl
import json
import logging
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.config.bench import BenchConfig
from hil.config.unchecked import changed_since
from hil.core.errors import ConfigError, RecordingError, reason_of
from hil.recording.mcap_writer import OnFailure
from hil.support.file_reading import json_object, read_bytes

LOG = logging.getLogger(__name__)

SCHEMA = 1
_KINDS = frozenset(
    {
        "run",
        "resume",
        "step",
        "end_step",
        "checkpoint",
        "value",
        "measure",
        "attach",
        "table",
        "figure",
        "data",
        "note",
        "recording",
        "answer",
        "held",
        "end",
    }
)

_HOLDS: Mapping[str, Mapping[str, type | tuple[type, ...]]] = {
    "checkpoint": {"title": str},
    "value": {"title": str, "value": object},
    "measure": {"name": str, "value": (int, float), "doubt": str},
    "attach": {"name": str, "path": str},
    "figure": {"title": str, "caption": str, "path": str},
    "table": {"title": str, "head": list, "rows": list, "note": str},
    "data": {"name": str, "value": object},
    "note": {"text": str},
    "recording": {"path": str},
    "held": {
        "bench": str,
        "checkpoint": str,
        "tethered": bool,
        "events": list,
        "wanted": bool,
        "state": str,
        "moved_m": (int, float, type(None)),
        "why": str,
    },
    "end": {"verdict": str},
}
_MOST_BYTES = 256 << 20
_UNFINISHED = ("ABORTED", "ERROR")

Entry = dict[str, Any]


class Journal:
    """Appends entries; each is on disk when `add` returns. While it is open the file is locked (shared).

    Args:
        path: the file; created if it does not exist.
        on_failure: reaction to an entry that cannot be written: `stop`, or `go-on`.

    Attributes:
        failure: reason why writing failed before the end of the run; empty if it did not.
    """

    def __init__(self, path: Path, on_failure: OnFailure = "stop") -> None:
        self.path, self.on_failure = path, on_failure
        self.failure = ""
        try:
            self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        except OSError as error:
            raise ConfigError(
                f"{path}: cannot be written ({reason_of(error)})",
                remedy="choose a folder that exists and has room",
            ) from None
        with suppress(OSError):  # some file systems have no locks
            fcntl.flock(self._fd, fcntl.LOCK_SH | fcntl.LOCK_NB)

    def add(self, kind: str, data: Mapping[str, Any]) -> None:
        """Append one entry; `data` holds JSON values.

        Raises:
            RecordingError: the entry cannot be written, and the run has to stop in this case.
        """
        if self.failure and self.on_failure == "go-on":
            return
        line = json.dumps({"kind": kind, **data}, default=str) + "\n"
        end = os.fstat(self._fd).st_size
        try:
            left = memoryview(line.encode())
            while left:
                left = left[os.write(self._fd, left) :]
            os.fsync(self._fd)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._fd, end)
            self.failure = f"cannot be written ({reason_of(error)})"
            if self.on_failure == "go-on":
                LOG.warning(
                    "%s: %s; the run goes on without it and cannot be resumed", self.path, self.failure
                )
                return
            raise RecordingError(
                str(self.path),
                self.failure,
                remedy="make room and continue with --resume; --on-recording-failure go-on drives on without",
            ) from None

    def close(self) -> None:
        """Close the file. Idempotent."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


@dataclass
class PastRun:
    """Content of the journal of an interrupted run.

    Attributes:
        header: first entry: procedure, its script and limits, parameters, seed, bench.
        checkpoints: entries made inside each finished checkpoint, by title; its value comes last.
        recordings: files written so far.
        held: final hold report of each bench, with its checkpoint.
        resumed: number of times that the run was resumed before.
    """

    header: Entry
    checkpoints: dict[str, list[Entry]] = field(default_factory=dict)
    recordings: list[str] = field(default_factory=list)
    held: list[Entry] = field(default_factory=list)
    resumed: int = 0

    @property
    def left_behind(self) -> bool:
        """Whether a finished checkpoint has moved an emulated robot and left its bench open."""
        return any(entries[-1].get("moved") for entries in self.checkpoints.values())


def read_journal(path: Path) -> PastRun:
    """Read the journal of an unfinished run.

    Raises:
        ConfigError: the journal is missing, damaged (names the line), has another schema, or is finished.
    """
    entries = _entries(path)
    if not entries or entries[0]["kind"] != "run":
        raise ConfigError(f"{path}: line 1 does not start a run", remedy="start the run anew")
    header = entries[0]
    if header.get("schema") != SCHEMA:
        raise ConfigError(f"{path}: schema {header.get('schema')!r}", expected=str(SCHEMA))
    past = PastRun(header)
    pending: dict[str, list[Entry]] = {}
    for number, entry in enumerate(entries[1:], start=2):
        kind = entry["kind"]
        try:
            if kind == "end" and entry["verdict"] not in _UNFINISHED:
                raise ConfigError(
                    f"{path}: the run is finished ({entry['verdict']})", remedy="nothing is left to resume"
                )
            if kind == "resume":
                past.resumed += 1
                pending.clear()
            elif kind == "recording":
                past.recordings.append(entry["path"])
            elif kind == "held":
                past.held.append(entry)
            elif kind == "checkpoint":
                pending[entry["title"]] = []
            elif kind == "value":
                past.checkpoints[entry["title"]] = [*pending.pop(entry["title"]), entry]
            for open_entries in pending.values():
                if kind not in ("checkpoint", "recording", "held", "end"):
                    open_entries.append(entry)
        except KeyError as error:
            raise ConfigError(f"{path}: line {number} lacks {error}", remedy="start the run anew") from None
    return past


def differences(then: Entry, now: Entry, config: BenchConfig) -> list[str]:
    """Return differences between an interrupted run and the run that resumes it; empty for none.

    Args:
        then: header of the interrupted run.
        now: header that the new run would have.
        config: configuration of its bench.
    """
    apart = ("config", "script", "measurements")
    found = [key for key in now if key not in apart and then.get(key) != now[key]]
    script, before = now["script"], then.get("script")
    if script and not (isinstance(before, Mapping) and before.get("sha256") == script["sha256"]):
        found.append(f"the script {script['file']}, which has changed")
    if then.get("measurements") != now["measurements"]:
        try:
            found += _limits(then["measurements"], now["measurements"])
        except (KeyError, TypeError):
            found.append("measurements")
    return found + [f"bench.{key}".rstrip(".") for key in changed_since(then.get("config"), config)]


def _limits(then: list[Entry], now: list[Entry]) -> Iterator[str]:
    """Yield measurements whose declarations differ, and how."""
    before, after = ({row["name"]: row for row in rows} for rows in (then, now))
    for name in dict.fromkeys((*before, *after)):
        one, other = before.get(name), after.get(name)
        if one is None or other is None:
            yield f"measurement {name} ({'new' if one is None else 'no longer declared'})"
        elif one != other:
            what = [f"{key} {one[key]}, now {other[key]}" for key in other if one[key] != other[key]]
            yield f"measurement {name} ({'; '.join(what)})"


def _entries(path: Path) -> list[Entry]:
    try:
        data = read_bytes(path, _MOST_BYTES)
    except ValueError as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from None
    except OSError as error:
        raise ConfigError(
            f"{path}: no journal to resume from ({reason_of(error)})", remedy="run without --resume"
        ) from None
    whole, _, _ = data.rpartition(b"\n")
    entries: list[Entry] = []
    for number, line in enumerate(whole.split(b"\n") if whole else [], start=1):
        try:
            entries.append(_entry(line))
        except KeyError as error:
            raise ConfigError(f"{path}: line {number} lacks {error}", remedy="start the run anew") from None
        except ValueError as error:
            raise ConfigError(
                f"{path}: line {number} is damaged ({error})", remedy="start the run anew; nothing was moved"
            ) from None
    return entries


def _entry(line: bytes) -> Entry:
    """Parse one line; raises `ValueError` if it is not an entry, `KeyError` if a key is missing."""
    entry = json_object(line)
    kind = entry.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise ValueError("no entry of a journal")
    for key, expected in _HOLDS.get(kind, {}).items():
        if not isinstance(entry[key], expected):
            raise ValueError(f"{key} is {entry[key]!r:.40}")
    return entry


def drop_torn_line(path: Path) -> None:
    """Remove an incomplete last line, so that the next entry starts on a new line."""
    data = path.read_bytes()
    whole, newline, torn = data.rpartition(b"\n")
    if torn:
        os.truncate(path, len(whole) + len(newline))
