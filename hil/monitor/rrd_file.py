"""A Rerun file: written through a pipe, and checked for completeness up to its end message.

Rerun writes into the pipe, a thread of ours into the file. If Rerun itself wrote to a full disk, its writer
thread would end, and a caller that closes the recording could wait for that thread for ever, in code that no
signal interrupts. A pipe is never full for long.
"""

import os
import struct
import sys
import threading
from collections.abc import Iterable
from pathlib import Path

from hil.core.errors import reason_of

_MAGIC, _OPENING_BYTES = b"RRF2", 12
_HEAD = struct.Struct("<QQ")
_END = 0
_PIECE = 1 << 16


def files_of(targets: Iterable[str]) -> tuple[str, ...]:
    """The outputs of a monitor that are files."""
    return tuple(name for name in targets if "://" not in name and Path(name).suffix == ".rrd")


def what_is_missing(path: Path) -> str:
    """Why a Rerun file is incomplete, in words; empty if it is complete.

    A full disk leaves a truncated file, which the library does not report.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            if file.read(_OPENING_BYTES)[: len(_MAGIC)] != _MAGIC:
                return "it does not begin as a Rerun file"
            while len(head := file.read(_HEAD.size)) == _HEAD.size:
                kind, length = _HEAD.unpack(head)
                if file.tell() + length > size:
                    break
                if kind == _END:
                    return ""
                file.seek(length, 1)
    except OSError as error:
        return f"it cannot be read ({error.strerror})"
    return f"it breaks off after {size / 1e6:.1f} MB"


class PipedFile:
    """One file that is written through a pipe.

    Args:
        path: path of the file; a file of that name is replaced.

    Attributes:
        entrance: path by which the pipe's writing end can be opened, until `opened` is called.

    Raises:
        OSError: the file cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = path.open("wb", buffering=0)
        self._exit, self._entrance = os.pipe()
        self.entrance = f"/dev/fd/{self._entrance}"
        self._thread = threading.Thread(target=self._copy, name="rerun file", daemon=True)
        self._thread.start()

    def opened(self) -> None:
        """Note that Rerun has opened the pipe: from now on the pipe ends when Rerun closes it."""
        os.close(self._entrance)

    def close(self, patience_s: float) -> None:
        """Wait until everything that Rerun sent is in the file.

        Args:
            patience_s: longest time for Rerun to close the pipe.
        """
        self._thread.join(patience_s)

    def _copy(self) -> None:
        """Thread: copy the pipe into the file; after a write error, read on and discard, to its end."""
        broken = False
        while piece := os.read(self._exit, _PIECE):
            if broken:
                continue
            try:
                self._put(memoryview(piece))
            except OSError as error:
                broken = True
                print(f"hil monitor: {self._path}: cannot be written ({reason_of(error)})", file=sys.stderr)
        os.close(self._exit)
        self._file.close()

    def _put(self, piece: memoryview) -> None:
        while piece:
            piece = piece[self._file.write(piece) :]
