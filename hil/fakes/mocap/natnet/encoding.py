"""Encodes NatNet packets as Motive sends them: 3.1, 4.0 and 4.1 (OptiTrack NatNet SDK)."""

import struct
from typing import NamedTuple

from hil.fakes.mocap.natnet.camera_view import SeenBody

VERSIONS = ((3, 1), (4, 0), (4, 1))
CONNECT, SERVER_INFO, REQUEST, RESPONSE, REQUEST_MODELS, MODELS, REQUEST_FRAME, FRAME = range(8)
DISCONNECT, KEEPALIVE, UNRECOGNISED = 9, 10, 100
APPLICATION = "Motive"

_HEAD = struct.Struct("<HH")
_INT = struct.Struct("<i")
_PAIR = struct.Struct("<iI")
_POINTS, _BODY = struct.Struct("<12f"), struct.Struct("<i3f4ffh")
_PACKED = struct.Struct(f"{_POINTS.size}s")
_LABELLED = struct.Struct("<" + 4 * "i3ffhf")
_SUFFIX, _SIZED_SUFFIX = struct.Struct("<IId3QHi"), struct.Struct("<IId3Q2IHi")
"""End of a frame; since 4.1 with two precision stamps, which are 0 in a system that is not synchronised."""
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
    """Encode a packet with one message."""
    return _HEAD.pack(identifier, len(payload)) + payload


def server_info(version: tuple[int, int], clock_hz: int, data_port: int, group: str | None) -> bytes:
    """Encode the description of the server."""
    address = bytes(int(part) for part in (group or "0.0.0.0").split("."))
    return message(
        SERVER_INFO,
        struct.pack("<256s4B", APPLICATION.encode(), *version, 0, 0)
        + struct.pack("<4BQHB", *version, 0, 0, clock_hz, data_port, group is not None)
        + address,
    )


def models(names: tuple[tuple[str, int], ...], version: tuple[int, int]) -> bytes:
    """Encode the definitions of marker sets and rigid bodies."""
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


class Frames:
    """Encoder of frames, with a cached template per version and set of bodies."""

    def __init__(self) -> None:
        self._templates: dict[tuple[object, ...], _Template] = {}

    def frame(
        self, number: int, bodies: tuple[SeenBody, ...], times: FrameTimes, version: tuple[int, int]
    ) -> bytes:
        """Encode one frame of motion capture data."""
        names = tuple([(body.name, body.identifier) for body in bodies])
        template = self._templates.get((version, names))
        if template is None:
            template = self._templates[version, names] = _Template(names, version)
        return template.filled(number, bodies, times)


class _Places(NamedTuple):
    """Byte offsets of one body in a frame: its markers (in two places), pose and labelled markers."""

    points: int
    points_in_all: int
    body: int
    labelled: int


class _Template:
    """Encoded frame of a fixed set of bodies, in which only changed fields are rewritten.

    Args:
        names: name and streaming id of the bodies, in order.
        version: bit stream version.
    """

    def __init__(self, names: tuple[tuple[str, int], ...], version: tuple[int, int]) -> None:
        sized, count = version >= (4, 1), len(names)

        def head(items: int, size: int) -> bytes:
            """Encode the head of a section."""
            return _PAIR.pack(items, size) if sized else _INT.pack(items)

        sets = [name.encode() + b"\0" + _INT.pack(4) for name, _ in names]
        shown_as_all = _SHOWN_AS_ALL + _INT.pack(4 * count)
        sets_size = sum(map(len, sets)) + len(shown_as_all) + 2 * count * _POINTS.size
        frame, nothing = bytearray(_HEAD.size + _INT.size), head(0, 0)

        def room(size: int) -> int:
            """Reserve bytes that are written later; returns their offset."""
            frame.extend(bytes(size))
            return len(frame) - size

        frame += head(count + 1, sets_size)
        points = []
        for one in sets:
            frame += one
            points.append(room(_POINTS.size))
        frame += shown_as_all
        in_all = [room(_POINTS.size) for _ in names]
        frame += nothing + head(count, count * _BODY.size)
        itself = [room(_BODY.size) for _ in names]
        frame += nothing * (2 if sized else 1) + head(4 * count, count * _LABELLED.size)
        labelled = [room(_LABELLED.size) for _ in names]
        frame += nothing * 2
        self._end, self._precision = (_SIZED_SUFFIX if sized else _SUFFIX), (0, 0) if sized else ()
        self._suffix = room(self._end.size)
        _HEAD.pack_into(frame, 0, FRAME, len(frame) - _HEAD.size)
        self._frame = frame
        self._places = [_Places(*places) for places in zip(points, in_all, itself, labelled, strict=True)]
        self._labels = [tuple(identifier << 16 | k for k in range(1, 5)) for _, identifier in names]
        self._known: list[SeenBody | None] = [None] * count

    def filled(self, number: int, bodies: tuple[SeenBody, ...], times: FrameTimes) -> bytes:
        """Return one encoded frame; unchanged bodies are not written again."""
        frame = self._frame
        _INT.pack_into(frame, _HEAD.size, number)
        for k, body in enumerate(bodies):
            if self._known[k] is not body:
                self._write(k, body)
        self._end.pack_into(frame, self._suffix, 0, 0, *times, *self._precision, 0, 0)
        return bytes(frame)

    def _write(self, k: int, body: SeenBody) -> None:
        frame, places, (i, j, m, n) = self._frame, self._places[k], self._labels[k]
        _, identifier, position_m, rotation_xyzw, (a, b, c, d), error_m, tracked = body
        rest = _MARKER_SIZE_M, _SOLVED, error_m
        points = _POINTS.pack(*a, *b, *c, *d)
        _PACKED.pack_into(frame, places.points, points)
        _PACKED.pack_into(frame, places.points_in_all, points)
        _BODY.pack_into(frame, places.body, identifier, *position_m, *rotation_xyzw, error_m, tracked)
        _LABELLED.pack_into(frame, places.labelled, i, *a, *rest, j, *b, *rest, m, *c, *rest, n, *d, *rest)
        self._known[k] = body
