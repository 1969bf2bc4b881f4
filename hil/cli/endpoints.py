"""The file of `hil emulate --out`: there while every endpoint answers, gone before and after."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from hil.vocabulary.errors import DataError, UsageError
from hil.vocabulary.reading import json_value, read_text

_MOST_BYTES = 1 << 20
_ADDRESSES = {"port", "interface", "server", "host"}


class EndpointsFile:
    """A file that clients wait for: what an earlier run left is removed at once.

    Args:
        path: where it shall appear; only an endpoints file, or an empty one, may be there already.

    Raises:
        UsageError: the path holds something else, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._text = ""
        try:
            if path.exists() and not _left_behind(path):
                raise UsageError(
                    f"--out {path}: it exists and holds something else than endpoints",
                    remedy="choose another name",
                )
            path.unlink(missing_ok=True)
            self._partial().touch()
            self._partial().unlink()
        except OSError as error:
            raise UsageError(
                f"--out {path}: cannot be written ({error.strerror or error})",
                expected="a file name in a folder that exists", remedy="choose another place",
            ) from None  # fmt: skip

    def _partial(self) -> Path:
        return self._path.with_name(f".{self._path.name}.{os.getpid()}")

    def write(self, text: str) -> None:
        """Let it appear, whole.

        Raises:
            DataError: it cannot be written.
        """
        partial = self._partial()
        try:
            partial.write_text(text + "\n", encoding="utf-8")
            os.replace(partial, self._path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise DataError(
                str(self._path), f"cannot be written ({error.strerror or error})",
                remedy="choose a place with room for --out",
            ) from None  # fmt: skip
        self._text = text + "\n"

    def remove(self) -> None:
        """Take it away, unless another emulator has put its own there. Idempotent; never raises."""
        with contextlib.suppress(OSError, UnicodeDecodeError):
            if self._text and self._path.read_text(encoding="utf-8") == self._text:
                self._path.unlink()


def _left_behind(path: Path) -> bool:
    """Whether a file is what an emulator leaves when it is killed, or empty."""
    try:
        text = read_text(path, _MOST_BYTES) if path.is_file() else "?"
        found = json_value(text) if text.strip() else {}
    except (OSError, ValueError):
        return False
    entries = found.values() if isinstance(found, dict) else ["?"]
    return all(isinstance(entry, dict) and _ADDRESSES & set(entry) for entry in entries)
