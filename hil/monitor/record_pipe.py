"""The format of the pipe from the loop's process to the monitor's: messages, each a pickle.

The first message is the scene. Each further one is a list of cycle records and paths, oldest first. An empty
message is the end. The head of a message holds its length and the number of cycles not shown so far.
"""

import copyreg
import io
import pickle
import struct
from collections.abc import Sequence
from typing import IO, Any, TypeAlias

import numpy as np

from hil.core.geometry import Array
from hil.core.signals import CycleRecord

Shown: TypeAlias = "CycleRecord | Array"
"""A cycle, or a path that the robot is going to follow."""

READY = b"hil monitor ready\n"
"""Line that the monitor's process prints when it has loaded Rerun."""

_HEAD = struct.Struct("<IQ")
_DOUBLE = np.dtype(np.float64)


def _array(shape: tuple[int, ...], raw: bytes) -> Array:
    found: Array = np.ndarray(shape, _DOUBLE, bytearray(raw))
    return found


def _reduced(array: Any) -> Any:
    """Pickle an array of doubles as bytes; a record has forty, and numpy's own way takes twice as long."""
    if array.dtype == _DOUBLE:
        return _array, (array.shape, array.tobytes())
    return array.__reduce_ex__(pickle.HIGHEST_PROTOCOL)


_REDUCED: dict[Any, Any] = {**copyreg.dispatch_table, np.ndarray: _reduced}


def packed(shown: Sequence[Shown]) -> bytes:
    """The payload of a message."""
    buffer = io.BytesIO()
    pickler = pickle.Pickler(buffer, pickle.HIGHEST_PROTOCOL)
    pickler.dispatch_table = _REDUCED
    pickler.dump(shown)
    return buffer.getvalue()


def put(pipe: IO[bytes], payload: bytes, dropped: int = 0) -> None:
    """Write one message; waits while the pipe is full.

    Args:
        pipe: pipe to the monitor's process.
        payload: bytes of the message; empty for the end.
        dropped: cycles that were not shown so far.

    Raises:
        OSError, ValueError: there is no reader, or the pipe is closed.
    """
    pipe.write(_HEAD.pack(len(payload), dropped) + payload)
    pipe.flush()


def taken(pipe: IO[bytes]) -> tuple[bytes, int]:
    """Read a message: payload, empty at the end or when the parent is gone; number of cycles not shown."""
    head = pipe.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return b"", 0
    length, dropped = _HEAD.unpack(head)
    payload = pipe.read(length)
    return (payload, dropped) if len(payload) == length else (b"", 0)
