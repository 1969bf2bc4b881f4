"""The few DroneCAN messages of a motor controller: set-points to it, its status, and "I am here".

Encoded here with the standard library only, because the process that keeps the fan running uses them; tests
compare every byte with PyPI `dronecan`. Set-points fit into one frame, a status takes three.
"""

import binascii
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from hil.core.errors import UsageError

NODE_STATUS, RAW_COMMAND, RPM_COMMAND, STATUS = 341, 1030, 1031, 1034
FULL_RAW = 8191
_STATUS_SEED = 0x1591
"""CRC of the data type signature of `uavcan.equipment.esc.Status`."""
_COMMAND_PRIORITY, _LOW_PRIORITY = 8, 31
_START, _END, _TOGGLE, _ID = 0x80, 0x40, 0x20, 0x1F
_RAW_BITS, _RPM_BITS = 14, 18
_ONE_FRAME_BITS = 56
_STATUS_BYTES, _FRAMES = 14, 3
_FLOATS = struct.Struct("<Ieee")


class CanFrame(NamedTuple):
    """An extended data frame."""

    id: int
    data: bytes


@dataclass(frozen=True)
class EscStatus:
    """`uavcan.equipment.esc.Status`; NaN for what the controller does not know.

    Attributes:
        node_id: node id of the controller.
        index: index of the controller in the arrays of commands.
        temperature_k: temperature of the hottest part, K.
        power_pct: share of the greatest power.
    """

    node_id: int
    error_count: int
    voltage_v: float
    current_a: float
    temperature_k: float
    rpm: int
    power_pct: int
    index: int


def command_frame(kind: int, index: int, value: int, *, node_id: int, transfer_id: int) -> CanFrame:
    """A set-point for one controller, none (0) for those before it.

    Args:
        kind: `RAW_COMMAND` (-8192..8191 of full) or `RPM_COMMAND`.
        index: index of the controller in the array of commands.
        value: the set-point.
        node_id: node id of the sender.
        transfer_id: counts up with each message of a kind.

    Raises:
        UsageError: a controller or value that does not fit into one frame.
    """
    bits = _RAW_BITS if kind == RAW_COMMAND else _RPM_BITS
    if not 0 <= index < _ONE_FRAME_BITS // bits or not -(1 << bits - 1) <= value < 1 << bits - 1:
        raise UsageError(
            f"DroneCAN set-point {value} for controller {index}",
            expected=f"controller 0 to {_ONE_FRAME_BITS // bits - 1}, {bits} bits",
        )
    text = "".join(_bits(v, bits) for v in (*[0] * index, value))
    return _single(kind, _packed(text), node_id, transfer_id, _COMMAND_PRIORITY)


def node_status_frame(uptime_s: int, *, node_id: int, transfer_id: int) -> CanFrame:
    """`uavcan.protocol.NodeStatus` of a node that is well, due once a second."""
    payload = struct.pack("<IBH", uptime_s & 0xFFFFFFFF, 0, 0)
    return _single(NODE_STATUS, payload, node_id, transfer_id, _LOW_PRIORITY)


def _single(kind: int, payload: bytes, node_id: int, transfer_id: int, priority: int) -> CanFrame:
    return CanFrame(
        priority << 24 | kind << 8 | node_id, payload + bytes([_START | _END | transfer_id & _ID])
    )


def command_of(frame_id: int, data: bytes | bytearray, index: int) -> tuple[int, int] | None:
    """(kind, value) of the set-point that a frame has for a controller; None where it has none."""
    kind = frame_id >> 8 & 0xFFFF
    whole = bool(data) and data[-1] & (_START | _END) == _START | _END
    if frame_id & 0x80 or kind not in (RAW_COMMAND, RPM_COMMAND) or not whole:
        return None
    bits = _RAW_BITS if kind == RAW_COMMAND else _RPM_BITS
    text = "".join(f"{byte:08b}" for byte in data[:-1])
    here = text[index * bits : (index + 1) * bits]
    return (kind, _signed(here)) if len(here) == bits else None


class StatusReader:
    """Reassembles status messages from frames, of any number of controllers."""

    def __init__(self) -> None:
        self._begun: dict[int, list[bytes]] = {}

    def take(self, frame_id: int, data: bytes | bytearray) -> EscStatus | None:
        """The status that a frame completes; None for any other frame."""
        if frame_id & 0x80 or frame_id >> 8 & 0xFFFF != STATUS or not data:
            return None
        node_id, tail = frame_id & 0x7F, data[-1]
        if tail & _START:
            self._begun[node_id] = []
        frames = self._begun.get(node_id)
        if frames is None:
            return None
        frames.append(bytes(data))
        toggled = bool(tail & _TOGGLE) == (len(frames) % 2 == 0)
        if not toggled or len(frames) > _FRAMES or (tail ^ frames[0][-1]) & _ID:
            del self._begun[node_id]
        elif tail & _END:
            del self._begun[node_id]
            return _status(node_id, b"".join(frame[:-1] for frame in frames))
        return None


def _status(node_id: int, whole: bytes) -> EscStatus | None:
    payload = whole[2:]
    if len(payload) != _STATUS_BYTES:
        return None
    if binascii.crc_hqx(payload, _STATUS_SEED) != int.from_bytes(whole[:2], "little"):
        return None
    errors, voltage_v, current_a, temperature_k = _FLOATS.unpack_from(payload)
    text = "".join(f"{byte:08b}" for byte in payload[_FLOATS.size :])
    power, index = int(text[18:25], 2), int(text[25:30], 2)
    return EscStatus(node_id, errors, voltage_v, current_a, temperature_k, _signed(text[:18]), power, index)


def _bits(value: int, width: int) -> str:
    """A number as DSDL writes it: its lowest byte first, each from its highest bit on."""
    text = f"{value & (1 << width) - 1:0{width}b}"
    return "".join(_from_lowest(text))


def _from_lowest(text: str) -> Iterator[str]:
    for end in range(len(text), 0, -8):
        yield text[max(0, end - 8) : end]


def _signed(text: str) -> int:
    """The number that `_bits` wrote."""
    whole = "".join(reversed([text[i : i + 8] for i in range(0, len(text), 8)]))
    value = int(whole, 2)
    return value - (1 << len(text)) if whole[0] == "1" else value


def _packed(text: str) -> bytes:
    text += "0" * (-len(text) % 8)
    return bytes(int(text[i : i + 8], 2) for i in range(0, len(text), 8))
