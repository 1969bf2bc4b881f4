"""A record on disk: versions that appear whole or not at all, one of them in place.

    record      the version in place (TOML), a copy of one in `history`
    history/    every version, by its number, never changed
    files/      what versions name, by name and hash: a calibration, offsets of a chip

New content is written beside, flushed to the disk and renamed, the version in place last. Whenever a process
is killed, the version in place is the old one or the new one, complete.
"""

import fcntl
import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from hil.config.robot_record.parts import PARTS, Confirmation, Identity, Part, RecordFile, digest_of
from hil.core.errors import ConfigError, reason_of
from hil.support.atomic_files import put_whole
from hil.support.file_reading import MOST_TOML_BYTES, read_bytes, read_toml

IN_PLACE, HISTORY, FILES = "record.toml", "history", "files"
_VERSION = re.compile(r"v(\d{4,})\.toml")


@dataclass(frozen=True)
class NewPart:
    """A part that is to be added; `files` are paths by key, copied into the record."""

    part: Part
    files: Mapping[str, Path] = field(default_factory=dict)


@dataclass(frozen=True)
class KeptVersion:
    """One version: its file, its content, and whether it is the one in place."""

    path: Path
    file: RecordFile
    in_place: bool


@dataclass(frozen=True)
class History:
    """All versions, oldest first, and what cannot be used: path and reason."""

    versions: tuple[KeptVersion, ...]
    damaged: tuple[tuple[Path, str], ...]


class RobotRecord:
    """The record in a folder, which need not exist yet.

    Args:
        folder: path of the folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def path(self) -> Path:
        """Path of the version in place."""
        return self.folder / IN_PLACE

    def exists(self) -> bool:
        """Whether there is a version in place, readable or not."""
        return self.path.is_file()

    def read(self) -> RecordFile:
        """The version in place.

        Raises:
            ConfigError: there is none; it is half-written or was changed by hand; its parts contradict each
                other or name files that are gone.
        """
        if not self.exists():
            raise self._nothing_there()
        return self._read(self.path)

    def _nothing_there(self) -> ConfigError:
        return ConfigError(
            f"{self.folder}: no record of a robot there",
            expected=f"a folder with {IN_PLACE}",
            remedy="make one with `hil commission`",
        )

    def _read(self, path: Path) -> RecordFile:
        file = read_version(path, f"hil robot rollback {self.folder}")
        problems = [*file.contradictions(), *self._missing(file)]
        if problems:
            raise ConfigError(
                f"{path}: {len(problems)} part(s) cannot be used; nothing of the record is applied",
                problems=tuple(problems),
                remedy=f"go back: hil robot rollback {self.folder}",
            )
        return file

    def _missing(self, file: RecordFile) -> Iterator[str]:
        for name, part in file.parts.items():
            for key, digest in part.files.items():
                path = self.folder / FILES / str(part.values.get(key))
                try:
                    found = hashlib.sha256(read_bytes(path, MOST_TOML_BYTES)).hexdigest()
                except (OSError, ValueError) as error:
                    yield f"{name}: {path} cannot be read ({reason_of(error)})"
                    continue
                if found != digest:
                    yield f"{name}: {path} was changed after it was measured"

    def path_of(self, part: Part, key: str) -> Path:
        """Path of a file that a part names."""
        return (self.folder / FILES / str(part.values[key])).resolve()

    def history(self) -> History:
        """Every version, and files beside them that are no usable version."""
        current = self.path.read_bytes() if self.exists() else None
        kept, damaged = [], []
        for path in sorted((self.folder / HISTORY).glob("*")):
            if _VERSION.fullmatch(path.name) is None:
                damaged.append((path, "half-written by a process that was killed"))
                continue
            try:
                kept.append(KeptVersion(path, read_version(path, ""), path.read_bytes() == current))
            except ConfigError as error:
                damaged.append((path, error.message.removeprefix(f"{path}: ")))
        if current is not None and not any(v.in_place for v in kept):
            damaged.append((self.path, "is none of the versions in its history"))
        return History(tuple(kept), tuple(damaged))

    def find(self, version: int) -> KeptVersion:
        """The version of that number; raises `ConfigError` that lists the numbers."""
        found = self.history().versions
        for kept in found:
            if kept.file.version == version:
                return kept
        if not found:
            raise self._nothing_there()
        numbers = ", ".join(str(v.file.version) for v in found)
        raise ConfigError(f"{self.folder}: no version {version}", expected=f"one of {numbers}")

    def add(
        self,
        parts: Mapping[str, NewPart],
        robot: Identity,
        *,
        created: str,
        why: str,
        confirmed: Mapping[str, Confirmation] | None = None,
        contradicted: Mapping[str, Any] | None = None,
    ) -> tuple[str, ...]:
        """Put a new version in place: the parts and confirmations, beside those there are.

        An older part that was measured on top of a part which changes now is left out. Without parts, and if
        nothing else was confirmed or contradicted than the record says, the version in place stays.

        Args:
            parts: parts to put in, by name.
            robot: robot that the parts are of.
            created: date and time, ISO 8601.
            why: origin of the parts, in words.
            confirmed: keys of the bench file that measurements have confirmed.
            contradicted: values that measurements have contradicted, by key: no longer confirmed.

        Returns:
            Names of the parts that were left out.

        Raises:
            ConfigError: the record is of another robot, or cannot be used.
        """
        with _alone(self.folder):
            before = self.read() if self.exists() else None
            if before is not None:
                check_robot(before, robot, self.path)
                robot = robot.model_copy(update={"body": robot.body or before.robot.body})
            kept = {} if before is None else before.confirmed
            wrong = contradicted or {}
            known = {
                key: one
                for key, one in {**kept, **(confirmed or {})}.items()
                if key not in wrong or not one.holds_for(wrong[key])
            }
            if not parts and known.keys() == kept.keys() and all(known[k].alike(kept[k]) for k in kept):
                return ()
            return self._added(parts, before, robot, (created, why), known)

    def _added(
        self,
        parts: Mapping[str, NewPart],
        before: RecordFile | None,
        robot: Identity,
        origin: tuple[str, str],
        confirmed: Mapping[str, Confirmation],
    ) -> tuple[str, ...]:
        merged = {} if before is None else dict(before.parts)
        new = {name: self._take_files(one) for name, one in parts.items()}
        for name in PARTS:
            if name in new:
                below = {p: merged[p].digest() for p in PARTS[name].on if p in merged}
                merged[name] = new[name].model_copy(update={"made_with": below})
        file = RecordFile(
            schema_version=1,
            version=self._next(),
            created=origin[0],
            why=origin[1],
            robot=robot,
            parts=merged,
            confirmed=dict(confirmed),
            previous="" if before is None else before.sha256,
        )
        whole, gone = file.without_stale()
        self._put_in_place(self._write(whole))
        return gone

    def _take_files(self, one: NewPart) -> Part:
        """The part with its files in the record, named by their content."""
        values, digests = dict(one.part.values), {}
        for key, path in one.files.items():
            try:
                content = read_bytes(path, MOST_TOML_BYTES)
            except (OSError, ValueError) as error:
                raise ConfigError(f"{path}: cannot be read ({reason_of(error)})") from None
            digests[key] = hashlib.sha256(content).hexdigest()
            values[key] = f"{path.stem}-{digests[key][:12]}{path.suffix}"
            _write_whole(self.folder / FILES / values[key], content)
        return one.part.model_copy(update={"values": values, "files": digests})

    def _next(self) -> int:
        names = [_VERSION.match(p.name) for p in (self.folder / HISTORY).glob("v*.toml*")]
        return max((int(m[1]) for m in names if m is not None), default=0) + 1

    def _write(self, file: RecordFile) -> Path:
        sealed = file.sealed()
        path = self.folder / HISTORY / f"v{sealed.version:04d}.toml"
        _write_whole(path, tomli_w.dumps({**sealed.tree(), "sha256": sealed.sha256}).encode())
        return path

    def _put_in_place(self, version: Path) -> None:
        _write_whole(self.path, version.read_bytes())

    def apply(self, version: int) -> KeptVersion:
        """Put a version in place; raises `ConfigError` where it cannot be used."""
        kept = self.find(version)
        self._read(kept.path)
        self._put_in_place(kept.path)
        return KeptVersion(kept.path, kept.file, in_place=True)

    def rollback(self, version: int | None = None) -> KeptVersion:
        """Put an earlier version back: the given one, else the one before the one in place.

        Raises:
            ConfigError: nothing to go back to.
        """
        if version is None:
            found = self.history().versions
            if not found:
                raise self._nothing_there()
            here = [v.file.version for v in found if v.in_place]
            earlier = [v.file.version for v in found if not here or v.file.version < here[0]]
            if not earlier:
                raise ConfigError(f"{self.folder}: no earlier version to go back to")
            version = earlier[-1]
        return self.apply(version)


def check_robot(file: RecordFile, robot: Identity, path: Path) -> None:
    """Refuse the record of another robot; raises `ConfigError` with everything that differs."""
    check_robot_is(
        file.robot,
        robot,
        f"{path}: the record of another robot; nothing of it is applied",
        "name this robot's record in [record], or another folder (--set bench.record.folder=DIR)",
    )


def check_robot_is(
    there: Identity, here: Identity, message: str, remedy: str, place: str = "in the record"
) -> None:
    """Refuse what is of another robot; raises `ConfigError` with everything that differs.

    Args:
        there: robot that the file is of.
        here: robot that is to use it.
        message: first line of the error.
        remedy: remedy that the error states.
        place: place of the identity `there`, for the message.
    """
    problems = tuple(there.differences(here, place))
    if problems:
        raise ConfigError(message, problems=problems, remedy=remedy)


def read_version(path: Path, remedy: str) -> RecordFile:
    """A version whose digest holds; raises `ConfigError` for one that is half-written or was changed."""
    try:
        tree: dict[str, Any] = read_toml(path)
    except ConfigError as error:
        raise ConfigError(f"{path}: half-written? {error.message}", remedy=remedy) from None
    reported = tree.pop("sha256", None)
    if not _holds(reported, tree):
        raise ConfigError(
            f"{path}: half-written, or changed by hand: its digest does not hold", remedy=remedy
        )
    try:
        return RecordFile.model_validate({**tree, "sha256": reported})
    except ValidationError as error:
        problems = tuple(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        raise ConfigError(f"{path}: no record of schema 1", problems=problems, remedy=remedy) from None


def _holds(digest: object, tree: dict[str, Any]) -> bool:
    """Whether a digest matches a tree; False for a tree with dates or NaN, which no record has."""
    try:
        return digest == digest_of(tree)
    except (TypeError, ValueError):
        return False


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep other processes from adding to the same record; a killed process frees the lock."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written ({reason_of(error)})") from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def _write_whole(path: Path, content: bytes) -> None:
    """Write a file by `put_whole`; raises `ConfigError`."""
    try:
        put_whole(path, content)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({reason_of(error)})") from None
