"""NatNet messages: header, requests, server description (little endian, OptiTrack NatNet SDK)."""

import enum
import struct
from typing import NamedTuple

HEAD = struct.Struct("<HH")
_SERVER = struct.Struct("<256s4B4BQHB4B")
_SHORT_SERVER = struct.Struct("<256s4B4B")


class Message(enum.IntEnum):
    """Identifiers of NatNet messages."""

    CONNECT = 0
    SERVER_INFO = 1
    REQUEST = 2
    RESPONSE = 3
    REQUEST_MODELS = 4
    MODELS = 5
    FRAME = 7
    KEEPALIVE = 10


class MalformedPacket(ValueError):
    """A packet contradicts its length, counts or version; it is dropped and counted."""


class ServerInfo(NamedTuple):
    """The description that a server sends of itself.

    `version` is (major, minor) of its NatNet bit stream, `clock_hz` the rate of its high-resolution
    time stamps, `multicast` its group or None for unicast (both unknown to servers before 3.0).
    """

    application: str
    application_version: str
    version: tuple[int, int]
    clock_hz: int
    data_port: int
    multicast: str | None


def request(message: Message, text: str = "") -> bytes:
    """A request as the public clients send it: a text that ends with zero."""
    payload = text.encode() + b"\0"
    return HEAD.pack(message, len(payload)) + payload


def split(data: bytes) -> tuple[int, bytes]:
    """Message identifier and payload; raises `MalformedPacket` if the length does not fit."""
    if len(data) < HEAD.size:
        raise MalformedPacket(f"{len(data)} bytes are no packet")
    identifier, length = HEAD.unpack_from(data)
    if length != len(data) - HEAD.size:
        raise MalformedPacket(f"{len(data) - HEAD.size} bytes of payload, {length} announced")
    return identifier, data[HEAD.size :]


def parse_server_info(payload: bytes) -> ServerInfo:
    """Server description; raises `MalformedPacket`."""
    if len(payload) < _SHORT_SERVER.size:
        raise MalformedPacket("the server description is too short")
    name, *versions = _SHORT_SERVER.unpack_from(payload)
    clock_hz, data_port, group = 0, 0, None
    if len(payload) >= _SERVER.size:
        *_, clock_hz, data_port, is_multicast, a, b, c, d = _SERVER.unpack_from(payload)
        group = f"{a}.{b}.{c}.{d}" if is_multicast else None
    return ServerInfo(
        application=name.split(b"\0", 1)[0].decode("utf-8", "replace"),
        application_version=".".join(map(str, versions[:4])),
        version=(versions[4], versions[5]),
        clock_hz=clock_hz,
        data_port=data_port,
        multicast=group,
    )
