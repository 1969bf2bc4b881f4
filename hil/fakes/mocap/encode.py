"""NatNet packets as Motive sends them: 3.1, 4.0 and 4.1 (OptiTrack NatNet SDK)."""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import NamedTuple

from hil.fakes.mocap.capture import SeenBody

VERSIONS = ((3, 1), (4, 0), (4, 1))
CONNECT, SERVER_INFO, REQUEST, RESPONSE, REQUEST_MODELS, MODELS, REQUEST_FRAME, FRAME = range(8)
DISCONNECT, KEEPALIVE, UNRECOGNISED = 9, 10, 100
APPLICATION = "Motive"

_HEAD = struct.Struct("<HH")
_INT = struct.Struct("<i")
_PAIR = struct.Struct("<iI")
_BODY_FORM, _MARKER_FORM, _SUFFIX_FORM = "i3f4ffh", "i3ffhf", "IId3QHi"
_MARKER_SIZE_M = 0.014
_SOLVED = 0x0A
_SHOWN_AS_ALL = b"all\0"


class FrameTimes(NamedTuple):
    """Time stamps of one frame: seconds since the start, and ticks of the server's clock."""

    timestamp_s: float
    exposure_ticks: int
    received_ticks: int
    sent_ticks: int


def message(identifier: int, payload: bytes = b"") -> bytes:
    """A packet of one message."""
    return _HEAD.pack(identifier, len(payload)) + payload


def server_info(version: tuple[int, int], clock_hz: int, data_port: int, group: str | None) -> bytes:
    """The server's description of itself."""
    address = bytes(int(part) for part in (group or "0.0.0.0").split("."))
    return message(
        SERVER_INFO,
        struct.pack("<256s4B", APPLICATION.encode(), *version, 0, 0)
        + struct.pack("<4BQHB", *version, 0, 0, clock_hz, data_port, group is not None)
        + address,
    )


def models(names: tuple[tuple[str, int], ...], version: tuple[int, int]) -> bytes:
    """Definitions of the marker sets and rigid bodies."""
    items = [(0, _marker_set_model(name)) for name, _ in (*names, ("all", 0))]
    items += [(1, _body_model(name, identifier, version)) for name, identifier in names]
    payload = _INT.pack(len(items))
    for kind, item in items:
        payload += _INT.pack(kind) + (_INT.pack(len(item)) if version >= (4, 1) else b"") + item
    return message(MODELS, payload)


def _marker_set_model(name: str) -> bytes:
    labels = b"".join(f"Marker{k}\0".encode() for k in range(1, 5))
    return name.encode() + b"\0" + _INT.pack(4) + labels


def _body_model(name: str, identifier: int, version: tuple[int, int]) -> bytes:
    markers = struct.pack("<i12f4i", 4, *(0.0,) * 12, *(0,) * 4)
    labels = b"".join(f"Marker{k}\0".encode() for k in range(1, 5)) if version >= (4, 0) else b""
    return name.encode() + b"\0" + struct.pack("<ii3f", identifier, -1, 0.0, 0.0, 0.0) + markers + labels


def frame(number: int, bodies: tuple[SeenBody, ...], times: FrameTimes, version: tuple[int, int]) -> bytes:
    """One frame of capture data."""
    form = _frame_form(tuple([(body.name, body.identifier) for body in bodies]), version)
    return form.pack(number, bodies, times)


class _FrameForm:
    """What frames of the same bodies have in common; a frame is packed in one step.

    Args:
        names: name and streaming id of the bodies, in order.
        version: of the bit stream.
    """

    def __init__(self, names: tuple[tuple[str, int], ...], version: tuple[int, int]) -> None:
        self._sized, count = version >= (4, 1), len(names)
        self._sets = [name.encode() + b"\0" + _INT.pack(4) for name, _ in names]
        self._all = _SHOWN_AS_ALL + _INT.pack(4 * count)
        self._labels = [identifier << 16 | k for _, identifier in names for k in range(1, 5)]
        sets = "".join(f"{len(name)}s12f" for name in self._sets) + f"{len(self._all)}s{12 * count}f"
        bodies, labelled = count * _BODY_FORM, 4 * count * _MARKER_FORM
        nothing = self._head(0, "")
        self._heads = (
            self._head(count + 1, sets),
            nothing + self._head(count, bodies),
            nothing * (2 if self._sized else 1) + self._head(4 * count, labelled),
            nothing * 2,
        )
        heads = [f"{len(head)}s" for head in self._heads]
        parts = ("<HHi", heads[0], sets, heads[1], bodies, heads[2], labelled, heads[3], _SUFFIX_FORM)
        self._whole = struct.Struct("".join(parts))

    def _head(self, count: int, form: str) -> bytes:
        """Beginning of a section of that many items."""
        return _PAIR.pack(count, struct.calcsize("<" + form)) if self._sized else _INT.pack(count)

    def pack(self, number: int, bodies: tuple[SeenBody, ...], times: FrameTimes) -> bytes:
        """One frame."""
        set_head, body_head, label_head, end = self._heads
        values: list[float | bytes] = [FRAME, self._whole.size - _HEAD.size, number, set_head]
        points: list[float] = []
        for name, body in zip(self._sets, bodies, strict=True):
            places = [v for marker in body.markers_m for v in marker]
            values += (name, *places)
            points += places
        values += (self._all, *points, body_head)
        for body in bodies:
            values += (body.identifier, *body.position_m, *body.rotation_xyzw)
            values += (body.marker_error_m, body.tracked)
        values.append(label_head)
        labels = iter(self._labels)
        for body in bodies:
            for x, y, z in body.markers_m:
                values += (next(labels), x, y, z, _MARKER_SIZE_M, _SOLVED, body.marker_error_m)
        values += (end, 0, 0, times.timestamp_s, times.exposure_ticks, times.received_ticks)
        return self._whole.pack(*values, times.sent_ticks, 0, 0)


_frame_form = lru_cache(maxsize=16)(_FrameForm)
