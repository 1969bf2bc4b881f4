"""Every parser of bytes that stands by itself: what it is fed with, and what it may raise."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import sealing
from emulations import recorded
from mutating import Seal

from hil.core.errors import HilError
from hil.drivers.mocap.natnet.messages import FrameParser, parse_frame
from hil.drivers.mocap.natnet.packets import MalformedPacket, parse_server_info, split
from hil.drivers.mocap.natnet.session import parse_models
from hil.drivers.servos.dynamixel.packets import GroupRead, find_statuses
from hil.drivers.tracker.t265.served_poses import FeedDevice
from hil.fakes.imu.bno055.uart import RequestParser
from hil.fakes.servos.dynamixel import protocol
from hil.fan_daemon.client import understood
from hil.fan_daemon.server import _answered
from hil.fan_daemon.spec import Spec
from hil.faults.fault import parse_fault
from hil.links.dronecan.messages import StatusReader, command_of
from hil.links.mavlink.messages import Parser, axes_of, dialect, pose_of, twist_of
from hil.links.mip import fields as mip_fields
from hil.links.mip.packets import PacketParser, encode
from hil.links.t265_datagrams import FEED_INFO, FEED_MAGIC, INFO_RECORD
from hil.links.vesc import messages as vesc
from hil.live.velocity_input import parse_command
from hil.recording import cdr
from hil.recording.rosbags_adapter import MessageMaker, from_cdr, to_cdr
from hil.support.file_reading import json_object, json_value, toml_tables


@dataclass(frozen=True)
class Fed:
    """A parser.

    Attributes:
        name: of the parser.
        feed: gives it bytes.
        seeds: sound input.
        may_raise: what it says of unsound input.
        seal: makes spoilt input credible.
    """

    name: str
    feed: Callable[[bytes], object]
    seeds: Sequence[bytes]
    may_raise: tuple[type[Exception], ...] = ()
    seal: Seal | None = None

    def __call__(self, data: bytes) -> None:
        """Feed it; anything but what it may raise goes through."""
        with suppress(*self.may_raise):
            self.feed(data)


def _text(parse: Callable[[str], object]) -> Callable[[bytes], object]:
    return lambda data: parse(data.decode("utf-8", "replace"))


def _servos() -> list[Fed]:
    ids = range(1, 9)
    values = [bytes([i] * 10) for i in ids]
    plain = b"".join(protocol.status(i, 0, v) for i, v in zip(ids, values, strict=True))
    fast = b"".join(protocol.fast_status([(i, 0, v) for i, v in zip(ids, values, strict=True)], 1 + 8 * 14))
    groups = {k: GroupRead(ids, 126, 10, fast=k) for k in (False, True)}

    def answers(data: bytes, fast: bool) -> None:
        found = groups[fast].answers(data)
        assert set(found) == set(ids)
        groups[fast].complete(data)

    return [
        Fed("servo statuses", find_statuses, [plain, fast], seal=sealing.dynamixel),
        Fed("servo sync read", lambda data: answers(data, False), [plain], seal=sealing.dynamixel),
        Fed("servo fast sync read", lambda data: answers(data, True), [fast], seal=sealing.dynamixel),
        Fed(
            "servo instructions",
            lambda data: protocol.InstructionParser().feed(data, 0, 1000),
            [protocol.packet(1, b"\x02\x84\x00\x04\x00"), protocol.packet(254, b"\x01")],
            seal=sealing.dynamixel,
        ),
    ]


def _microstrain() -> list[Fed]:
    def feed(data: bytes) -> None:
        for packet in PacketParser(10_000_000).feed(data, 0):
            mip_fields.FilterData.of(packet)
            for field in packet.fields:
                mip_fields.format_entries(field.data)

    seeds = [
        encode(0x82, [(0x03, bytes(20)), (0x12, bytes(12)), (0x10, b"\x00\x02\x00\x01\x00\x00")]),
        encode(0x0C, [(0xF1, b"\x08\x00"), (0x8A, bytes(22))]),
    ]
    return [Fed("MIP packets", feed, seeds, seal=sealing.microstrain)]


def _camera() -> list[Fed]:
    common = dialect()
    speaker = common.MAVLink(None, srcSystem=1, srcComponent=197)
    message = common.MAVLink_odometry_message(
        1, 20, 12, 0.1, 0.2, 0.3, [1.0, 0, 0, 0], 0.1, 0, 0, 0, 0, 0.1, [0.1] * 21, [0.1] * 21, 0, 3, 100
    )

    def feed(data: bytes) -> None:
        for found in Parser(common, datagrams=True).feed(data):
            axes = axes_of(found.frame_id, found.child_frame_id) if found.get_type() == "ODOMETRY" else None
            if axes is not None:
                pose_of(found, axes)
                twist_of(found, axes, (1.0, 0.0, 0.0, 0.0))

    return [Fed("MAVLink", feed, [message.pack(speaker), *[b"\xfd" + bytes(30)]], seal=sealing.mavlink)]


def _mocap() -> list[Fed]:
    def feed(data: bytes) -> None:
        kind, payload = split(data)
        if kind == 7:
            for version in ((2, 9), (3, 0), (3, 1), (4, 0), (4, 1)):
                with suppress(MalformedPacket):
                    parse_frame(payload, version, 1)
            parser.parse(payload)
        elif kind == 5:
            parse_models(payload, (4, 1))
        else:
            parse_server_info(payload)

    parser = FrameParser((4, 1), 1)
    return [Fed("NatNet", feed, recorded("natnet"), (MalformedPacket,), sealing.natnet)]


def _holding() -> list[Fed]:
    reader = StatusReader()

    def framed(take: Callable[[int, bytes], object]) -> Callable[[bytes], object]:
        return lambda data: take(int.from_bytes(data[:4].ljust(4, b"\0"), "big"), data[4:12])

    spec = Spec(interface="hil", channel="fuzz", controller_id=1)
    statuses = [vesc.address(p, 1).to_bytes(4, "big") + bytes(8) for p in vesc.Packet]
    refused = {"error": {"message": "m", "expected": "e", "remedy": "r", "exit_code": 3}}
    reported = [json.dumps(answer).encode() for answer in ({"state": "idle", "sent": None}, refused)]
    asked = [b'{"do": "set", "quantity": "duty", "value": 0.5}', b'{"do": "off", "confirmed_by": "me"}']
    return [
        Fed("VESC frames", framed(vesc.decode), statuses),
        Fed("DroneCAN status", framed(reader.take), [b"\x18\x04\x0a\x01" + bytes(8)]),
        Fed("DroneCAN command", framed(lambda i, d: command_of(i, d, 0)), [b"\x18\x04\x06\x01" + bytes(8)]),
        Fed("daemon's answer", lambda d: understood(d, spec), reported, (HilError,)),
        Fed("daemon's request", lambda d: _answered(d, "me", lambda a, w: a), asked),
        Fed("daemon's start", _text(Spec.from_json), [spec.to_json().encode()], (HilError,)),
    ]


def _feed(data: bytes) -> None:
    FeedDevice(data[: INFO_RECORD.size].ljust(INFO_RECORD.size, b"\0")).get_info("name")


def _cdr(kind: str, sound: object) -> Fed:
    return Fed(f"CDR {kind}", lambda data: from_cdr(data, kind), [to_cdr(sound)], (ValueError,))


def _texts() -> list[Fed]:
    toml = b'schema = 1\n[imu]\nport = "x"\nrate = 1.5\n[[fault]]\nat = 1979-05-27\n'
    return [
        Fed("TOML", lambda d: toml_tables(d.decode("utf-8", "replace"), "x"), [toml], (HilError,)),
        Fed("JSON", lambda d: json_value(d), [b'{"a": [1, 2.5, null, "\\u00e9"]}'], (ValueError,)),
        Fed("JSON object", lambda d: json_object(d), [b'{"a": [1, {"b": true}]}'], (ValueError,)),
        Fed("fault", _text(parse_fault), [b"imu:stuck@2+3,a=0.2", b"plant:off"], (HilError,)),
        Fed("velocity command", _text(parse_command), [b"v 0.1 0 -0.2", b"stop"], (HilError,)),
        _cdr("std_msgs/msg/UInt8MultiArray", cdr.octets(b"abcd")),
        _cdr("std_msgs/msg/String", MessageMaker().message("std_msgs/msg/String", data="abcd")),
        Fed("camera feed", _feed, [INFO_RECORD.pack(FEED_MAGIC, FEED_INFO, b"T265", b"1", b"0.2.0.951")]),
        Fed("BNO055 requests", lambda d: RequestParser().feed(d, 0), [b"\xaa\x01\0\x08\xaa\0\x3d\x01\x0c"]),
    ]


def parsers() -> list[Fed]:
    """All of them."""
    return [*_servos(), *_microstrain(), *_camera(), *_mocap(), *_holding(), *_texts()]
