"""The CAN frames of a VESC: identifiers, orders to it, and its reports (firmware `comm/comm_can.c`).

Extended identifiers, `command << 8 | controller id`; big endian, two's complement. Only the standard
library, because the process that keeps the fan running uses it too.
"""

import math
import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from hil.core.errors import UsageError

ALL_SERVOS = 255
"""Broadcast id: every controller obeys commands to it."""
HIGHEST_ID = 254
"""Highest id of a single controller."""

_INT32, _INT16 = struct.Struct(">i"), struct.Struct(">h")
_LONGEST_OFF_DELAY_S = 32.767
_LOWEST, _HIGHEST = -(1 << 31), (1 << 31) - 1


class Packet(IntEnum):
    """`CAN_PACKET_ID` of the firmware, as far as a fan needs it."""

    SET_DUTY = 0
    SET_CURRENT = 1
    SET_CURRENT_BRAKE = 2
    SET_RPM = 3
    SET_POS = 4
    STATUS = 9
    SET_CURRENT_REL = 10
    SET_CURRENT_BRAKE_REL = 11
    SET_CURRENT_HANDBRAKE = 12
    SET_CURRENT_HANDBRAKE_REL = 13
    STATUS_2 = 14
    STATUS_3 = 15
    STATUS_4 = 16
    PING = 17
    PONG = 18
    STATUS_5 = 27
    STATUS_6 = 58


_LSB_PER_UNIT: dict[int, float] = {
    Packet.SET_DUTY: 1e5,
    Packet.SET_CURRENT: 1e3,
    Packet.SET_CURRENT_BRAKE: 1e3,
    Packet.SET_RPM: 1.0,
    Packet.SET_POS: 1e6,
    Packet.SET_CURRENT_REL: 1e5,
    Packet.SET_CURRENT_BRAKE_REL: 1e5,
    Packet.SET_CURRENT_HANDBRAKE: 1e3,
    Packet.SET_CURRENT_HANDBRAKE_REL: 1e5,
}


_WITH_OFF_DELAY = frozenset({Packet.SET_CURRENT, Packet.SET_CURRENT_REL})


class CanFrame(NamedTuple):
    """An extended data frame."""

    id: int
    data: bytes


@dataclass(frozen=True)
class Order:
    """A `SET_*` command. Each renews the controller's timeout, whatever it sets.

    Attributes:
        controller_id: the receiver; `ALL_SERVOS` for all.
        packet: the quantity.
        value: duty -1..1, current A, electrical rpm, position deg, or share of the configured current.
        off_delay_s: time for which the controller goes on modulating at 0 A, of a (relative) current; None
            for a command without this field.
    """

    controller_id: int
    packet: Packet
    value: float
    off_delay_s: float | None = None


@dataclass(frozen=True)
class Pong:
    """The answer to a ping.

    Attributes:
        controller_id: id of the controller that answers.
        asker_id: id of the node that sent the ping.
        hardware: type of the hardware, 0 for a motor controller; None from firmware that does not report it.
    """

    controller_id: int
    asker_id: int
    hardware: int | None


@dataclass(frozen=True)
class Status:
    """Message 1: electrical rpm (pole pairs times mechanical), motor current in A, duty -1..1."""

    controller_id: int
    erpm: float
    current_a: float
    duty: float


@dataclass(frozen=True)
class Status2:
    """Message 2: charge drawn from and returned to the battery, Ah."""

    controller_id: int
    drawn_ah: float
    charged_ah: float


@dataclass(frozen=True)
class Status3:
    """Message 3: energy drawn from and returned to the battery, Wh."""

    controller_id: int
    drawn_wh: float
    charged_wh: float


@dataclass(frozen=True)
class Status4:
    """Message 4: temperatures of FETs and motor (degC), battery current (A), position (deg)."""

    controller_id: int
    fet_c: float
    motor_c: float
    input_a: float
    position_deg: float


@dataclass(frozen=True)
class Status5:
    """Message 5: tachometer, six counts for each electrical turn; battery voltage, V."""

    controller_id: int
    tachometer: int
    input_v: float


@dataclass(frozen=True)
class Status6:
    """Message 6: voltages of three analogue inputs; level of the pulse input, -1..1."""

    controller_id: int
    adc1_v: float
    adc2_v: float
    adc3_v: float
    pulse: float


Message = Order | Pong | Status | Status2 | Status3 | Status4 | Status5 | Status6


class _Layout(NamedTuple):
    """Layout by which a report is unpacked; `lsb_per_unit` has a figure for each field."""

    made: type[Status | Status2 | Status3 | Status4 | Status5 | Status6]
    data: struct.Struct
    lsb_per_unit: tuple[float, ...]


_REPORTS: dict[int, _Layout] = {
    Packet.STATUS: _Layout(Status, struct.Struct(">ihh"), (1, 10, 1000)),
    Packet.STATUS_2: _Layout(Status2, struct.Struct(">ii"), (1e4, 1e4)),
    Packet.STATUS_3: _Layout(Status3, struct.Struct(">ii"), (1e4, 1e4)),
    Packet.STATUS_4: _Layout(Status4, struct.Struct(">hhhh"), (10, 10, 10, 50)),
    Packet.STATUS_5: _Layout(Status5, struct.Struct(">ih"), (1, 10)),
    Packet.STATUS_6: _Layout(Status6, struct.Struct(">hhhh"), (1000, 1000, 1000, 1000)),
}


def address(packet: Packet, controller_id: int) -> int:
    """The 29-bit identifier; raises `UsageError` for an impossible controller id."""
    if not 0 <= controller_id <= ALL_SERVOS:
        raise UsageError(
            f"VESC controller id {controller_id}", expected=f"0 to {HIGHEST_ID}, or {ALL_SERVOS} for all"
        )
    return packet << 8 | controller_id


def order_frame(order: Order) -> CanFrame:
    """The frame of a command, rounded to the wire's resolution; the controller clips it to its range.

    Raises:
        UsageError: a packet that sets nothing, or a value that the wire cannot carry.
    """
    lsb_per_unit = _LSB_PER_UNIT.get(order.packet)
    if lsb_per_unit is None:
        raise UsageError(f"{order.packet.name} sets nothing", expected="a SET_... packet")
    if (
        not math.isfinite(order.value)
        or not _LOWEST <= (raw := round(order.value * lsb_per_unit)) <= _HIGHEST
    ):
        raise UsageError(
            f"{order.packet.name} {order.value}", expected=f"a number within +-{_HIGHEST / lsb_per_unit:.6g}"
        )
    return CanFrame(address(order.packet, order.controller_id), _INT32.pack(raw) + _off_delay(order))


def _off_delay(order: Order) -> bytes:
    """The two optional bytes of a current command; empty without; raises `UsageError`."""
    if order.off_delay_s is None:
        return b""
    if order.packet not in _WITH_OFF_DELAY or not 0.0 <= order.off_delay_s <= _LONGEST_OFF_DELAY_S:
        raise UsageError(
            f"{order.packet.name} with an off delay of {order.off_delay_s} s",
            expected=f"a current or relative current, and 0 to {_LONGEST_OFF_DELAY_S} s",
        )
    return _INT16.pack(round(1000 * order.off_delay_s))


def ping_frame(controller_id: int, asker_id: int) -> CanFrame:
    """The frame that requests a `Pong` to `asker_id` from a controller, or all; renews no timeout."""
    return CanFrame(address(Packet.PING, controller_id), bytes([asker_id]))


def decode(frame_id: int, data: bytes | bytearray) -> Message | None:
    """Decode an extended frame; None for any other packet and for one that is too short.

    Longer data is accepted: the firmware has appended to its frames before.
    """
    command, controller_id = frame_id >> 8, frame_id & 0xFF
    if (report := _REPORTS.get(command)) is not None:
        return _report(report, controller_id, data)
    if command == Packet.PONG:
        return Pong(data[0], controller_id, data[1] if len(data) > 1 else None) if data else None
    lsb_per_unit = _LSB_PER_UNIT.get(command)
    if lsb_per_unit is None or len(data) < _INT32.size:
        return None
    off_delay_s = None
    if command in _WITH_OFF_DELAY and len(data) >= _INT32.size + _INT16.size:
        off_delay_s = _INT16.unpack_from(data, _INT32.size)[0] / 1000.0
    return Order(controller_id, Packet(command), _INT32.unpack_from(data)[0] / lsb_per_unit, off_delay_s)


def _report(layout: _Layout, controller_id: int, data: bytes | bytearray) -> Message | None:
    if len(data) < layout.data.size:
        return None
    raws = layout.data.unpack_from(data)
    values = [raw if lsb == 1 else raw / lsb for raw, lsb in zip(raws, layout.lsb_per_unit, strict=True)]
    return layout.made(controller_id, *values)
