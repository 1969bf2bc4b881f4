"""Makes spoilt messages credible again: with the length and the checksum that their protocols ask for."""

from __future__ import annotations

import struct
from typing import Any

from fastcrc import crc16

from hil.fakes.servos.dynamixel import protocol
from hil.links.mavlink.messages import dialect
from hil.links.mip import packets as mip

_BODIES = 8
_CRC_EXTRA: dict[int, int] = {}


def dynamixel(data: bytes) -> bytes:
    """Protocol 2.0: everything behind the identifier is a new body."""
    at = data.find(b"\xff\xff\xfd\x00")
    if at < 0 or len(data) < at + _BODIES:
        return protocol.packet(data[0] % 253 if data else 1, data[1:60] or b"\x55\x00")
    return data[:at] + protocol.packet(data[at + 4], protocol.unstuff(data[at + 7 : -2]) or b"\x55")


def microstrain(data: bytes) -> bytes:
    """MIP: the payload gets its length and Fletcher's sums."""
    payload = data[mip.HEAD_BYTES : -mip.CHECKSUM_BYTES][: mip.LARGEST_PAYLOAD]
    frame = mip.SYNC + data[2:3].ljust(1, b"\x80") + bytes([len(payload)]) + payload
    return frame + mip.checksum(frame)


def natnet(data: bytes) -> bytes:
    """NatNet: message number and the payload's length."""
    payload = data[4:]
    return data[:2].ljust(2, b"\x07") + struct.pack("<H", min(len(payload), 65_535)) + payload


def mavlink(data: bytes) -> bytes:
    """MAVLink 2: length and checksum with the extra byte of the message's definition."""
    if len(data) < 12 or data[0] != 0xFD:
        return data
    payload = data[10:-2][:255]
    head = bytes([0xFD, len(payload)]) + b"\0" + data[3:10]
    checked = head[1:] + payload + bytes([_extra(int.from_bytes(data[7:10], "little"))])
    return head + payload + struct.pack("<H", crc16.mcrf4xx(checked))


def _extra(message: int) -> int:
    if not _CRC_EXTRA:
        known: dict[int, Any] = dialect().mavlink_map
        _CRC_EXTRA.update({number: kind.crc_extra for number, kind in known.items()})
    return _CRC_EXTRA.get(message, 0)


SEALS = {"dynamixel": dynamixel, "microstrain": microstrain, "natnet": natnet, "mavlink": mavlink}
"""By model."""
