"""Protocol 2.0 packets of the control cycle: built once, parsed without a loop over bytes.

The SDK's packet handler serves set-up (`bus.py`). It is not used for the cycle because it drops the
error byte of each servo, declares a whole group lost when one member is, and returns zero, a legal
position, for no data (read in dynamixel_sdk).
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from fastcrc import crc16

from hil.core.signals import Status
from hil.drivers.servos.dynamixel.register_map import Fields

BROADCAST = 0xFE
ALERT, ERROR_NUMBER = 0x80, 0x7F
ERROR_TEXT = {
    1: "could not carry it out",
    2: "does not know the instruction",
    3: "received it with a wrong checksum",
    4: "takes no such value",
    5: "expects another length",
    6: "has a limit below this value",
    7: "does not let the register be written now",
}
_HEADER = b"\xff\xff\xfd\x00"
_TO_STUFF, _CODE_AT = b"\xff\xff\xfd", 7
"""Bytes that must not appear behind a packet's length, and the index of its instruction."""
_STATUS = 0x55
_SYNC_READ, _SYNC_WRITE, _FAST_SYNC_READ = 0x82, 0x83, 0x8A
_BULK_WRITE = 0x93
_PING = 0x01
_STATUS_OVERHEAD, _FAST_HEAD, _FAST_OVERHEAD = 11, 8, 4
_LONGEST = 2048


@dataclass(frozen=True)
class Answer:
    """The answer of one servo, or why there is none: `data` is empty unless `status` is OK."""

    status: Status
    error: int = 0
    data: bytes = b""


NO_ANSWER = Answer(Status.TIMEOUT)
BAD_CHECKSUM = Answer(Status.CRC)


def instruction(servo_id: int, code: int, parameters: bytes = b"") -> bytes:
    """Build an instruction packet."""
    body = (bytes((code,)) + parameters).replace(_TO_STUFF, _TO_STUFF + b"\xfd")
    data = _HEADER + bytes((servo_id,)) + (len(body) + 2).to_bytes(2, "little") + body
    crc: int = crc16.umts(data)
    return data + crc.to_bytes(2, "little")


def ping_all() -> bytes:
    """Build the broadcast ping."""
    return instruction(BROADCAST, _PING)


def sync_write(address: int, length: int, parts: Sequence[tuple[int, bytes]]) -> bytes:
    """Write `length` bytes from `address` in several servos (ID, data)."""
    head = address.to_bytes(2, "little") + length.to_bytes(2, "little")
    return instruction(
        BROADCAST, _SYNC_WRITE, head + b"".join(bytes((servo_id,)) + data for servo_id, data in parts)
    )


def find_statuses(data: bytes) -> list[tuple[int, Answer]]:
    """Status packets in a stream that may hold noise, echoes and pieces, as (ID, answer) in order."""
    found, start = [], 0
    while (start := data.find(_HEADER, start)) >= 0:
        if start + _STATUS_OVERHEAD > len(data):
            break
        length = data[start + 5] | data[start + 6] << 8
        end = start + 7 + length
        if data[start + 7] != _STATUS or not 4 <= length <= _LONGEST or end > len(data):
            start += 4
            continue
        packet = data[start:end]
        if crc16.umts(packet[:-2]) == packet[-2] | packet[-1] << 8:
            body = packet[9:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            found.append((packet[4], Answer(Status.OK, packet[8], body)))
            start = end
        else:
            found.append((packet[4], BAD_CHECKSUM))
            start += 4
    return found


class GroupRead:
    """One sync read of the same registers of several servos, plain or fast.

    Args:
        ids: IDs of the servos, in the order of the request.
        address: address of the first register.
        length: bytes.
        fast: True if they answer in one packet.
        fields: the registers, for `quick`.

    Attributes:
        request: the packet, built once.
        expected: bytes of a complete answer without stuffing.
    """

    def __init__(
        self, ids: Sequence[int], address: int, length: int, *, fast: bool, fields: Fields | None = None
    ) -> None:
        self.ids, self.length, self.fast = tuple(ids), length, fast
        where = address.to_bytes(2, "little") + length.to_bytes(2, "little")
        code = _FAST_SYNC_READ if fast else _SYNC_READ
        self.request = instruction(BROADCAST, code, where + bytes(ids))
        count = len(self.ids)
        overhead = _FAST_OVERHEAD if fast else _STATUS_OVERHEAD
        self.expected = count * (length + overhead) + (_FAST_HEAD if fast else 0)
        declared = (self.expected - 7).to_bytes(2, "little")
        self._head = _HEADER + bytes((BROADCAST,)) + declared + bytes((_STATUS,))
        self._ids, self._no_errors = bytes(self.ids), bytes(count)
        tail = (length + 4).to_bytes(2, "little") + bytes((_STATUS,))
        self._heads = [_HEADER + bytes((i,)) + tail for i in self.ids]
        if fields is not None:
            head, before = ("8x", "2x") if fast else ("", "9x")
            self._unpack = struct.Struct("<" + head + f"{before}{fields.form}2x" * count).unpack
            self._places = [(name, slice(k, None, len(fields.names))) for k, name in enumerate(fields.names)]

    def plausible(self, data: bytes) -> bool:
        """Whether the bytes have the length and the heads of a complete answer without stuffing."""
        if len(data) != self.expected:
            return False
        if self.fast:
            return data[:_FAST_HEAD] == self._head
        step = self.length + _STATUS_OVERHEAD
        return all(data[k * step : k * step + _FAST_HEAD] == head for k, head in enumerate(self._heads))

    def quick(self, data: bytes) -> dict[str, tuple[int, ...]] | None:
        """Raw counts of all servos by register, in request order, of a clean answer without alerts."""
        if not self.plausible(data):
            return None
        step = self.length + (_FAST_OVERHEAD if self.fast else _STATUS_OVERHEAD)
        if data[_FAST_HEAD::step] != self._no_errors:
            return None
        if self.fast:
            if crc16.umts(data[:-2]) != data[-2] | data[-1] << 8 or data[_FAST_HEAD + 1 :: step] != self._ids:
                return None
        else:
            for k in range(0, self.expected, step):
                end = k + step - 2
                if crc16.umts(data[k:end]) != data[end] | data[end + 1] << 8:
                    return None
        values = self._unpack(data)
        return {name: values[place] for name, place in self._places}

    def answers(self, data: bytes) -> dict[int, Answer]:
        """Answer of every servo in the request, whatever arrived."""
        found = self._pieces(data) if self.fast else find_statuses(data)
        answers = dict.fromkeys(self.ids, NO_ANSWER)
        for servo_id, answer in found:
            if servo_id not in answers or answers[servo_id].status is Status.OK:
                continue
            if answer.status is Status.OK and (
                answer.error & ERROR_NUMBER or len(answer.data) != self.length
            ):
                answer = Answer(Status.PROTOCOL, answer.error)
            answers[servo_id] = answer
        return answers

    def complete(self, data: bytes) -> bool:
        """Whether nothing more needs to be waited for."""
        if self.fast:
            start = data.find(self._head)
            return start >= 0 and len(data) - start >= self.expected
        return all(a.status is not Status.TIMEOUT for a in self.answers(data).values())

    def _pieces(self, data: bytes) -> list[tuple[int, Answer]]:
        """Servos' pieces of a fast answer; each checksum covers everything before it."""
        start = data.find(self._head)
        if start < 0:
            return []
        found: list[tuple[int, Answer]] = []
        step = self.length + _FAST_OVERHEAD
        waiting = list(self.ids)
        for k in range(start + _FAST_HEAD, len(data) - step + 1, step):
            if not waiting:
                break
            end = k + step
            error, servo_id = data[k], data[k + 1]
            if crc16.umts(data[start : end - 2]) != data[end - 2] | data[end - 1] << 8:
                found += [(i, BAD_CHECKSUM) for i in waiting[: (len(data) - k) // step]]
                break
            if servo_id not in waiting:
                break
            del waiting[: waiting.index(servo_id) + 1]
            found.append((servo_id, Answer(Status.OK, error, data[k + 2 : end - 2])))
        return found


class GoalWrite:
    """The one write of a control cycle: four bytes for each servo.

    Drives take Goal Velocity (104) and steers Goal Position (116). Mapped to the same indirect data, a
    sync write of 54 bytes serves both; without the map a bulk write of 82 bytes does.

    Args:
        ids: IDs of the eight servos.
        addresses: addresses: one for all of them makes a sync write, one for each a bulk write.
    """

    def __init__(self, ids: Sequence[int], addresses: Sequence[int] | int) -> None:
        if isinstance(addresses, int):
            self._code = _SYNC_WRITE
            self._prefix = addresses.to_bytes(2, "little") + b"\x04\x00"
            heads = [bytes((servo_id,)) for servo_id in ids]
        else:
            self._code, self._prefix = _BULK_WRITE, b""
            heads = [
                bytes((servo_id,)) + address.to_bytes(2, "little") + b"\x04\x00"
                for servo_id, address in zip(ids, addresses, strict=True)
            ]
        self._parts: list[bytes | int] = [value for head in heads for value in (head, 0)]
        self._pack = struct.Struct("<" + "".join(f"{len(head)}si" for head in heads)).pack
        usual = instruction(BROADCAST, self._code, self._prefix + self._pack(*self._parts))
        begins = _CODE_AT + 1 + len(self._prefix)
        self._begin = usual[:begins]

    def packet(self, goals: Sequence[int]) -> bytes:
        """The packet for eight raw goals."""
        parts = self._parts
        parts[1::2] = goals
        reported = self._pack(*parts)
        data = self._begin + reported
        if data.find(_TO_STUFF, _CODE_AT) >= 0:
            return instruction(BROADCAST, self._code, self._prefix + reported)
        crc: int = crc16.umts(data)
        return data + crc.to_bytes(2, "little")
