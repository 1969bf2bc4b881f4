"""Model definitions: which rigid bodies a server streams, by streaming id.

Since 4.1 every definition contains its size; before, all kinds have to be read to get past them.
"""

from __future__ import annotations

import struct

from hil.drivers.mocap.natnet_packets import MalformedPacket
from hil.drivers.mocap.payload_reader import Cursor

_RIGID_BODY = 1
_PLACE = struct.Struct("<ii3f")
_QUATERNION, _OFFSET, _LABEL = 16, 12, 4
_PLATE_GEOMETRY = 4 * (2 + 3 + 144 + 12)
_CAMERA = 28


def parse_models(payload: bytes, version: tuple[int, int]) -> dict[int, str]:
    """Names of the rigid bodies by streaming id; raises `MalformedPacket` and nothing else."""
    cursor = Cursor(payload)
    bodies: dict[int, str] = {}
    sized = version >= (4, 1)
    for _ in range(cursor.count(8)):
        kind = cursor.integer()
        end = cursor.integer() + cursor.at if sized else None
        if kind == _RIGID_BODY:
            identifier, name = _rigid_body(cursor, version)
            bodies[identifier] = name
        elif end is None:
            _pass_over(cursor, kind, version)
        if end is not None:
            cursor.skip(end - cursor.at)
    return bodies


def _rigid_body(cursor: Cursor, version: tuple[int, int]) -> tuple[int, str]:
    name = cursor.text()
    identifier, *_ = cursor.take(_PLACE)
    if version >= (4, 2):
        cursor.skip(_QUATERNION)
    markers = cursor.count(_OFFSET + _LABEL)
    cursor.skip(markers * (_OFFSET + _LABEL))
    if version >= (4, 0):
        for _ in range(markers):
            cursor.text()
    return identifier, name


def _pass_over(cursor: Cursor, kind: int, version: tuple[int, int]) -> None:
    if kind == 0:
        cursor.text()
        _names(cursor)
    elif kind == 2:
        cursor.text()
        cursor.integer()
        for _ in range(cursor.count(_PLACE.size)):
            _rigid_body(cursor, version)
    elif kind == 3:
        cursor.integer()
        cursor.text()
        cursor.skip(_PLATE_GEOMETRY + 8)
        _names(cursor)
    elif kind == 4:
        cursor.integer()
        cursor.text()
        cursor.text()
        cursor.skip(8)
        _names(cursor)
    elif kind == 5:
        cursor.text()
        cursor.skip(_CAMERA)
    else:
        raise MalformedPacket(f"model definition of unknown kind {kind}")


def _names(cursor: Cursor) -> None:
    for _ in range(cursor.count(1)):
        cursor.text()
