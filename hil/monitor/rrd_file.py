"""A Rerun file: written behind a pipe, and checked to be whole, by its messages up to the one that ends it.

Rerun writes into the pipe, a thread of ours into the file. Where Rerun itself meets a full disk, the thread
of it that writes ends, and a caller that closes the recording may wait for that thread for ever, in code that
no signal reaches. A pipe is never full for long.
"""

from __future__ import annotations

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
    """Why a file of Rerun is not whole; empty where it is.

    A disk that was full leaves a file that breaks off, of which the library says nothing.
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
        path: of the file; a file of that name is replaced.

    Attributes:
        entrance: the name under which the pipe's end for writing is opened, until `opened` is called.

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
        """Rerun holds the pipe now: it ends when Rerun lets go."""
        os.close(self._entrance)

    def close(self, patience_s: float) -> None:
        """Wait until all is written that Rerun let go of.

        Args:
            patience_s: how long Rerun may take for it.
        """
        self._thread.join(patience_s)

    def _copy(self) -> None:
        """Thread: the pipe is emptied to its end, also when the disk takes no more."""
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
