"""Deletes results and nothing else: what `hil` did not write, what a run is writing, and links stay."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hil.core.errors import DataError, reason_of
from hil.report.history.index import OURS, Kept, in_use
from hil.report.history.own_files import FOLDERS, all_files, written

_PRECIOUS = ("calibration.toml", "bench_fragment.toml", "record.toml")
_SHOWN = 4


@dataclass(frozen=True)
class Loss:
    """What goes with a result, and what does not.

    Attributes:
        kept: the result.
        files: what goes, as paths within its folder.
        size_bytes: of that.
        precious: names of those that others may build on.
        stays: what `hil` has not written, as paths within the folder.
    """

    kept: Kept
    files: tuple[str, ...]
    size_bytes: int
    precious: tuple[str, ...]
    stays: tuple[str, ...] = ()

    def in_words(self) -> str:
        """One line for the question before the removal."""
        what = f"{self.kept.name}: {self.kept.what} {self.kept.verdict or self.kept.kind}"
        part = f", part of {self.kept.within}" if self.kept.within else ""
        held = f", with {', '.join(self.precious)}" if self.precious else ""
        size = f"{len(self.files)} files, {self.size_bytes / 1e6:.1f} MB"
        return "; ".join(filter(None, (f"{what}, {size}{held}{part}", self.stays_in_words())))

    def stays_in_words(self) -> str:
        """What is left of the folder and why; empty where all of it goes."""
        if not self.stays:
            return ""
        few = ", ".join(self.stays[:_SHOWN]) + (", ..." if len(self.stays) > _SHOWN else "")
        if len(self.stays) == 1:
            return f"1 file that is not part of it stays in {self.kept.folder}: {few}"
        return f"{len(self.stays)} files that are not part of it stay in {self.kept.folder}: {few}"


def loss(root: Path, kept: Kept) -> Loss:
    """What would be lost; checks that it may be deleted.

    Raises:
        DataError: it is foreign, still in use, or lies outside the folder of results.
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
    """Delete what was looked at, and the folders that are empty then.

    Raises:
        DataError: a file cannot be deleted; names it. Those before it are gone.
    """
    for item in losses:
        folder = item.kept.folder
        for name in item.files:
            try:
                (folder / name).unlink(missing_ok=True)
            except OSError as error:
                raise DataError(str(folder / name), f"cannot be deleted ({reason_of(error)})") from None
        for place in _emptied(item):
            with suppress(OSError):  # it holds files of another program
                os.rmdir(place)


def _emptied(item: Loss) -> Iterator[Path]:
    """Folders that `hil` has made for what it wrote, the deepest first, the result's own last."""
    folder = item.kept.folder
    held = {place for name in item.files for place in (folder / name).parents if place != folder}
    within = {place for place in held if place.is_relative_to(folder)} | {folder / name for name in FOLDERS}
    yield from sorted(within, key=lambda place: len(place.parts), reverse=True)
    yield folder
