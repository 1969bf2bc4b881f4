"""NatNet packets as Motive sends them: 3.1, 4.0 and 4.1 (OptiTrack NatNet SDK)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from hil.fakes.mocap.capture import SeenBody

VERSIONS = ((3, 1), (4, 0), (4, 1))
CONNECT, SERVER_INFO, REQUEST, RESPONSE, REQUEST_MODELS, MODELS, REQUEST_FRAME, FRAME = range(8)
DISCONNECT, KEEPALIVE, UNRECOGNISED = 9, 10, 100
APPLICATION = "Motive"

_HEAD = struct.Struct("<HH")
_INT = struct.Struct("<i")
_PAIR = struct.Struct("<iI")
_BODY = struct.Struct("<i3f4ffh")
_MARKER = struct.Struct("<i3ffhf")
_SUFFIX = struct.Struct("<IId3QHi")
_MARKER_SIZE_M = 0.014
_SOLVED = 0x0A
_SHOWN_AS_ALL = b"all\0"


@dataclass(frozen=True)
class FrameTimes:
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
    sized = version >= (4, 1)
    points = [[v for marker in body.markers_m for v in marker] for body in bodies]
    sets = [
        body.name.encode() + b"\0" + struct.pack("<i12f", 4, *p)
        for body, p in zip(bodies, points, strict=True)
    ]
    everything = [v for p in points for v in p]
    sets.append(_SHOWN_AS_ALL + struct.pack(f"<i{len(everything)}f", 4 * len(bodies), *everything))
    labelled = [
        _MARKER.pack(body.identifier << 16 | k, *marker, _MARKER_SIZE_M, _SOLVED, body.marker_error_m)
        for body in bodies
        for k, marker in enumerate(body.markers_m, 1)
    ]
    nothing: list[bytes] = []
    sections = [sets, nothing, [_body(body) for body in bodies], nothing, labelled, nothing, nothing]
    if sized:
        sections.insert(4, nothing)
    suffix = _SUFFIX.pack(
        0, 0, times.timestamp_s, times.exposure_ticks, times.received_ticks, times.sent_ticks, 0, 0
    )
    return message(FRAME, _INT.pack(number) + b"".join(_section(items, sized) for items in sections) + suffix)


def _body(body: SeenBody) -> bytes:
    return _BODY.pack(
        body.identifier, *body.position_m, *body.rotation_xyzw, body.marker_error_m, body.tracked
    )


def _section(items: list[bytes], sized: bool) -> bytes:
    data = b"".join(items)
    return (_PAIR.pack(len(items), len(data)) if sized else _INT.pack(len(items))) + data
