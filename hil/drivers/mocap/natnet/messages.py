"""Frames of motion capture data, NatNet 3.0 to 4.x: the pose of one rigid body and the time stamps.

Sections in order (OptiTrack NatNet SDK): marker sets, unlabelled markers, rigid bodies,
skeletons, (4.1: assets,) labelled markers, force plates, devices, suffix. Since 4.1 each section
gives its size after its count.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NamedTuple

from hil.drivers.mocap.natnet.packets import MalformedPacket
from hil.drivers.mocap.natnet.payload_reader import Cursor

_NUMBER = struct.Struct("<i")
_BODY = struct.Struct("<i3f4ffh")
_SUFFIX = struct.Struct("<IId3Q")
_PARAMETERS = struct.Struct("<H")
_MARKER, _LABELLED, _FLOAT = 12, 26, 4
_PRECISION, _TAIL = 8, 6
_SIZED = (4, 1)
_TRACKED, _MODELS_CHANGED = 0x01, 0x02
_LEAST_NAMED = 5
_PAIR = struct.Struct("<iI")
_POSE_VALUES, _END_VALUES = 9, 5


class _Section(NamedTuple):
    """Layout of a section to pass over: least size of an item, and a function to skip one of varying size."""

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


class FrameParser:
    """Parses the frames of one stream; a frame of the same shape as the last one is unpacked in one step.

    Args:
        version: NatNet (major, minor) of the bit stream, at least 3.0.
        body_id: streaming id of the rigid body to find.
    """

    def __init__(self, version: tuple[int, int], body_id: int) -> None:
        self.version, self.body_id = version, body_id
        self._shape: _Shape | None = None

    def parse(self, payload: bytes) -> Frame:
        """Parse a message as `parse_frame` does."""
        frame = self._shape.frame(payload) if self._shape is not None else None
        if frame is None:
            frame = parse_frame(payload, self.version, self.body_id)
            if self.version >= _SIZED and frame.body is not None:
                self._shape = _Shape.of(payload, self.body_id)
        return frame


class _Shape:
    """Layout of a frame whose sections give their sizes, and the bytes that must match for it to apply.

    Args:
        layout: layout of the whole payload: the number, heads of sections and identifiers, the body, the
            suffix.
        known: values of heads and identifiers.
        place: index of the body among the values that are unpacked.
    """

    def __init__(self, layout: struct.Struct, known: tuple[bytes, ...], place: int) -> None:
        self._layout, self._place = layout, place
        self._before, self._after = known[: place - 1], known[place - 1 :]

    @classmethod
    def of(cls, payload: bytes, body_id: int) -> _Shape | None:
        """The shape of a payload that has been parsed; None where its bodies do not fill their section."""
        at, form, known, place = _NUMBER.size, ["<i"], [], 0
        for section in range(1 + len(_BEFORE_BODIES) + len(_AFTER_BODIES)):
            count, size = _PAIR.unpack_from(payload, at)
            known.append(payload[at : at + _PAIR.size])
            at += _PAIR.size
            form.append(f"{_PAIR.size}s")
            if section != len(_BEFORE_BODIES):
                form.append(f"{size}x")
            elif size != count * _BODY.size:
                return None
            else:
                for k in range(count):
                    raw = payload[at + k * _BODY.size : at + k * _BODY.size + _NUMBER.size]
                    known.append(raw)
                    mine = _NUMBER.unpack(raw)[0] == body_id
                    place = len(known) + 1 if mine else place
                    form.append("4s3f4ffh" if mine else f"4s{_BODY.size - _NUMBER.size}x")
            at += size
        tail = len(payload) - at - _SUFFIX.size
        precision = _PRECISION if tail >= _PRECISION + _TAIL else 0
        form.append(f"8xd3Q{precision}xH{tail - precision - _PARAMETERS.size}x")
        return cls(struct.Struct("".join(form)), tuple(known), place)

    def frame(self, payload: bytes) -> Frame | None:
        """A frame of this shape; None for any other."""
        if len(payload) != self._layout.size:
            return None
        values, place = self._layout.unpack(payload), self._place
        if values[1:place] != self._before or values[place + _POSE_VALUES : -_END_VALUES] != self._after:
            return None
        x, y, z, qx, qy, qz, qw, error, parameters = values[place : place + _POSE_VALUES]
        body = BodyPose((x, y, z), (qx, qy, qz, qw), error, parameters & _TRACKED != 0)
        changed = values[-1] & _MODELS_CHANGED != 0
        stamp_s, exposure, received, sent = values[-_END_VALUES:-1]
        return Frame(values[0], body, stamp_s, exposure, received, sent, changed)


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
