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
_POINTS, _BODY = struct.Struct("<12f"), struct.Struct("<i3f4ffh")
_LABELLED = struct.Struct("<" + 4 * "i3ffhf")
_SUFFIX = struct.Struct("<IId3QHi")
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


class _Pieces(NamedTuple):
    """What a frame says of one body: all of its markers, the body, its labelled markers."""

    points: bytes
    body: bytes
    labelled: bytes


class _FrameForm:
    """What frames of the same bodies have in common, so that only what has moved is packed.

    Args:
        names: name and streaming id of the bodies, in order.
        version: of the bit stream.
    """

    def __init__(self, names: tuple[tuple[str, int], ...], version: tuple[int, int]) -> None:
        self._sized, count = version >= (4, 1), len(names)
        self._sets = [name.encode() + b"\0" + _INT.pack(4) for name, _ in names]
        self._labels = [tuple(identifier << 16 | k for k in range(1, 5)) for _, identifier in names]
        shown_as_all = _SHOWN_AS_ALL + _INT.pack(4 * count)
        sets_size = sum(map(len, self._sets)) + len(shown_as_all) + 2 * count * _POINTS.size
        nothing = self._head(0, 0)
        self._set_head, self._all = self._head(count + 1, sets_size), shown_as_all
        self._body_head = nothing + self._head(count, count * _BODY.size)
        self._label_head = nothing * (2 if self._sized else 1) + self._head(4 * count, count * _LABELLED.size)
        self._end = nothing * 2
        fixed = (self._set_head, self._body_head, self._label_head, self._end)
        each = count * (_BODY.size + _LABELLED.size)
        self._payload = _INT.size + sets_size + each + sum(map(len, fixed)) + _SUFFIX.size
        self._known: list[tuple[SeenBody, _Pieces] | None] = [None] * count

    def _head(self, count: int, size: int) -> bytes:
        """Beginning of a section of that many items."""
        return _PAIR.pack(count, size) if self._sized else _INT.pack(count)

    def _pieces(self, place: int, body: SeenBody) -> _Pieces:
        """What the frame says of a body; one that is seen as before is not packed again."""
        known = self._known[place]
        if known is not None and known[0] is body:
            return known[1]
        _, identifier, position_m, rotation_xyzw, markers_m, error_m, tracked = body
        labelled: list[float] = []
        for label, marker in zip(self._labels[place], markers_m, strict=True):
            labelled += (label, *marker, _MARKER_SIZE_M, _SOLVED, error_m)
        a, b, c, d = markers_m
        pieces = _Pieces(
            _POINTS.pack(*a, *b, *c, *d),
            _BODY.pack(identifier, *position_m, *rotation_xyzw, error_m, tracked),
            _LABELLED.pack(*labelled),
        )
        self._known[place] = body, pieces
        return pieces

    def pack(self, number: int, bodies: tuple[SeenBody, ...], times: FrameTimes) -> bytes:
        """One frame."""
        pieces = [self._pieces(place, body) for place, body in enumerate(bodies)]
        parts = [_HEAD.pack(FRAME, self._payload), _INT.pack(number), self._set_head]
        for name, piece in zip(self._sets, pieces, strict=True):
            parts += (name, piece.points)
        parts.append(self._all)
        parts += [piece.points for piece in pieces]
        parts.append(self._body_head)
        parts += [piece.body for piece in pieces]
        parts.append(self._label_head)
        parts += [piece.labelled for piece in pieces]
        parts += (self._end, _SUFFIX.pack(0, 0, *times, 0, 0))
        return b"".join(parts)


_frame_form = lru_cache(maxsize=16)(_FrameForm)
