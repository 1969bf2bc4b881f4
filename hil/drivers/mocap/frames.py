"""Frames of motion capture data, NatNet 3.0 to 4.x: the pose of one rigid body and the time stamps.

Sections in order (OptiTrack NatNet SDK): marker sets, unlabelled markers, rigid bodies,
skeletons, (4.1: assets,) labelled markers, force plates, devices, suffix. Since 4.1 each section
tells its size after its count.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NamedTuple

from hil.drivers.mocap.cursor import Cursor
from hil.drivers.mocap.packets import MalformedPacket

_NUMBER = struct.Struct("<i")
_BODY = struct.Struct("<i3f4ffh")
_SUFFIX = struct.Struct("<IId3Q")
_PARAMETERS = struct.Struct("<H")
_MARKER, _LABELLED, _ASSET_MARKER, _FLOAT = 12, 26, 26, 4
_PRECISION, _TAIL = 8, 6
_SIZED = (4, 1)
_TRACKED, _MODELS_CHANGED = 0x01, 0x02
_LEAST_NAMED = 5


class _Section(NamedTuple):
    """How to pass over a section: the least size of an item, and how to skip one of varying size."""

    least_size: int
    skip: Callable[[Cursor], None] | None = None


class BodyPose(NamedTuple):
    """One rigid body as streamed: m, quaternion x y z w, mean marker error m."""

    position_m: tuple[float, float, float]
    rotation_xyzw: tuple[float, float, float, float]
    marker_error_m: float
    tracked: bool


class Frame(NamedTuple):
    """One frame. Ticks count the server's clock; `body` is None when the frame lacks it."""

    number: int
    body: BodyPose | None
    timestamp_s: float
    exposure_ticks: int
    received_ticks: int
    sent_ticks: int
    models_changed: bool


def frame_number(payload: bytes) -> int:
    """The number alone, to recognise repetitions cheaply."""
    if len(payload) < _NUMBER.size:
        raise MalformedPacket("a frame without number")
    number: int = _NUMBER.unpack_from(payload)[0]
    return number


def parse_frame(payload: bytes, version: tuple[int, int], body_id: int) -> Frame:
    """One frame's data; raises `MalformedPacket` and nothing else.

    Args:
        payload: message without header.
        version: NatNet (major, minor) of the bit stream, at least 3.0.
        body_id: streaming id of the rigid body to find.
    """
    cursor = Cursor(payload)
    number = cursor.integer()
    sized = version >= _SIZED
    for section in _BEFORE_BODIES:
        _pass_over(cursor, section, sized)
    body = _bodies(cursor, sized, body_id)
    for section in _AFTER_BODIES if sized else _AFTER_BODIES_40:
        _pass_over(cursor, section, sized)
    _, _, timestamp_s, exposure, received, sent = cursor.take(_SUFFIX)
    if cursor.left >= _PRECISION + _TAIL:
        cursor.skip(_PRECISION)
    (parameters,) = cursor.take(_PARAMETERS)
    return Frame(number, body, timestamp_s, exposure, received, sent, bool(parameters & _MODELS_CHANGED))


def _pass_over(cursor: Cursor, section: _Section, sized: bool) -> None:
    count = cursor.count(section.least_size)
    if sized:
        cursor.skip(cursor.integer())
    elif section.skip is None:
        cursor.skip(count * section.least_size)
    else:
        for _ in range(count):
            section.skip(cursor)


def _bodies(cursor: Cursor, sized: bool, body_id: int) -> BodyPose | None:
    count = cursor.count(_BODY.size)
    size = cursor.integer() if sized else count * _BODY.size
    end = cursor.at + size
    found = None
    for _ in range(count):
        identifier, x, y, z, qx, qy, qz, qw, error, parameters = cursor.take(_BODY)
        if identifier == body_id:
            found = BodyPose((x, y, z), (qx, qy, qz, qw), error, bool(parameters & _TRACKED))
    cursor.skip(end - cursor.at)
    return found


def _marker_set(cursor: Cursor) -> None:
    cursor.text()
    cursor.skip(cursor.count(_MARKER) * _MARKER)


def _skeleton(cursor: Cursor) -> None:
    cursor.integer()
    cursor.skip(cursor.count(_BODY.size) * _BODY.size)


def _channels(cursor: Cursor) -> None:
    cursor.integer()
    for _ in range(cursor.count(4)):
        cursor.skip(cursor.count(_FLOAT) * _FLOAT)


_BEFORE_BODIES = (_Section(_LEAST_NAMED, _marker_set), _Section(_MARKER))
_SKELETONS, _LABELLED_MARKERS = _Section(8, _skeleton), _Section(_LABELLED)
_FORCE_PLATES = _DEVICES = _Section(8, _channels)
_AFTER_BODIES_40 = (_SKELETONS, _LABELLED_MARKERS, _FORCE_PLATES, _DEVICES)
_AFTER_BODIES = (_SKELETONS, _Section(12), _LABELLED_MARKERS, _FORCE_PLATES, _DEVICES)
