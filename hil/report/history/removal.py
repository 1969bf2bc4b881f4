"""Deletes results, and nothing else: what a run is still writing, what is foreign, what is a link stays."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hil.report.history.found import OURS, Kept, in_use
from hil.vocabulary.errors import DataError

_PRECIOUS = ("calibration.toml", "bench_fragment.toml", "*.mcap")


@dataclass(frozen=True)
class Loss:
    """What goes with a result: its files, its size, and which of them others may build on."""

    kept: Kept
    files: int
    size_bytes: int
    precious: tuple[str, ...]

    def in_words(self) -> str:
        """One line for whoever is asked."""
        what = f"{self.kept.name}: {self.kept.what} {self.kept.verdict or self.kept.kind}"
        part = f", part of {self.kept.within}" if self.kept.within else ""
        held = f", with {', '.join(self.precious)}" if self.precious else ""
        return f"{what}, {self.files} files, {self.size_bytes / 1e6:.1f} MB{held}{part}"


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
            str(folder), "is not deleted: it is the folder of results itself",
            remedy="name the folder above it with --in",
        )  # fmt: skip
    if in_use(folder):
        raise DataError(
            str(folder), "is not deleted: a run is still writing to it", remedy="wait for its end"
        )
    files = [p for p in folder.rglob("*") if p.is_file() and not p.is_symlink()]
    precious = {p.name for pattern in _PRECIOUS for p in folder.rglob(pattern)}
    return Loss(kept, len(files), sum(p.stat().st_size for p in files), tuple(sorted(precious)[:6]))


def delete(losses: Sequence[Loss]) -> None:
    """Delete what was looked at; links in it are taken away, what they lead to stays.

    Raises:
        DataError: a folder cannot be deleted; names it. Those before it are gone.
    """
    for item in losses:
        folder = item.kept.folder
        try:
            shutil.rmtree(folder)
        except OSError as error:
            raise DataError(str(folder), f"cannot be deleted ({error.strerror or error})") from None
