"""Checks that a Rerun file is whole, by walking through its messages to the one that ends it."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path

_MAGIC, _OPENING_BYTES = b"RRF2", 12
_HEAD = struct.Struct("<QQ")
_END = 0


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
