"""The file of `hil emulate --out`: it exists only while every endpoint answers."""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from pathlib import Path
from typing import IO

from hil.core.errors import DataError, DeviceTimeoutError, UsageError, reason_of
from hil.support.file_reading import json_value, read_text

_MOST_BYTES = 1 << 20
_ADDRESSES = {"port", "interface", "server", "host"}
_LOOK_S = 0.05


class EndpointsFile:
    """A file that clients wait for; one that an earlier run left is removed at once.

    It is locked (`flock`) while its emulator runs, so that a file that was left behind can be recognised.

    Args:
        path: path of the file; only an endpoints file that was left behind, or an empty one, may be there
            already.

    As a context manager it removes the file at the end of the block.

    Raises:
        UsageError: the path holds something else, or the endpoints of an emulator that runs, or cannot be
            written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._text = ""
        self._held: IO[str] | None = None
        try:
            if path.exists() and not _left_behind(path):
                raise UsageError(
                    f"--out {path}: it exists and holds something else than endpoints",
                    remedy="choose another name",
                )
            self._refuse_a_living_one()
            path.unlink(missing_ok=True)
            self._partial().touch()
            self._partial().unlink()
        except OSError as error:
            raise UsageError(
                f"--out {path}: cannot be written ({reason_of(error)})",
                expected="a file name in a folder that exists",
                remedy="choose another place",
            ) from None

    def _refuse_a_living_one(self) -> None:
        if _of_a_living_emulator(self._path) is not None:
            raise UsageError(
                f"--out {self._path}: an emulator that runs has its endpoints there",
                remedy="choose another name, or end that emulator",
            )

    def _partial(self) -> Path:
        return self._path.with_name(f".{self._path.name}.{os.getpid()}")

    def write(self, text: str) -> None:
        """Create the file atomically with this text.

        Raises:
            DataError: it cannot be written.
            UsageError: another emulator has put its own there meanwhile.
        """
        self._refuse_a_living_one()
        partial = self._partial()
        try:
            self._held = partial.open("w", encoding="utf-8")
            fcntl.flock(self._held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._held.write(text + "\n")
            self._held.flush()
            os.replace(partial, self._path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise DataError(
                str(self._path),
                f"cannot be written ({reason_of(error)})",
                remedy="choose a place with room for --out",
            ) from None
        self._text = text + "\n"

    def __enter__(self) -> EndpointsFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.remove()

    def remove(self) -> None:
        """Remove the file, unless another emulator has put its own there. Idempotent; never raises."""
        with contextlib.suppress(OSError, UnicodeDecodeError):
            if self._text and self._path.read_text(encoding="utf-8") == self._text:
                self._path.unlink()
        if self._held is not None:
            with contextlib.suppress(OSError):
                self._held.close()


def await_endpoints(path: Path, patience_s: float) -> str:
    """Wait until a running emulator has written an endpoints file; returns its content.

    Args:
        path: path of the file, as given to `--out`.
        patience_s: longest wait, s.

    Raises:
        UsageError: no emulator can put it there, or something else is there.
        DeviceTimeoutError: it has not appeared, or only one that an emulator left behind.
    """
    if not path.parent.is_dir() or (path.exists() and not _left_behind(path)):
        raise UsageError(
            f"--wait {path}: no endpoints will be there",
            expected="the name that was given to --out",
            remedy="look for a typing error",
        )
    end_s = time.monotonic() + patience_s
    while (text := _of_a_living_emulator(path)) is None:
        if time.monotonic() >= end_s:
            found = "was left behind by an emulator that is gone" if path.exists() else "has not appeared"
            raise DeviceTimeoutError(
                "emulate",
                f"{path} {found} after {patience_s:g} s",
                expected=f"hil emulate --out {path} in another terminal, or before in the background",
                remedy="look at what it says",
            )
        time.sleep(_LOOK_S)
    return text


def _of_a_living_emulator(path: Path) -> str | None:
    """The text of a locked file; None where there is none, or it is not locked."""
    try:
        with path.open(encoding="utf-8") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return file.read(_MOST_BYTES)
    except (OSError, UnicodeDecodeError):
        pass
    return None


def _left_behind(path: Path) -> bool:
    """Whether a file is empty or was left by a killed emulator."""
    try:
        text = read_text(path, _MOST_BYTES) if path.is_file() else "?"
        found = json_value(text) if text.strip() else {}
    except (OSError, ValueError):
        return False
    entries = found.values() if isinstance(found, dict) else ["?"]
    return all(isinstance(entry, dict) and _ADDRESSES & set(entry) for entry in entries)
