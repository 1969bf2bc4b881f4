"""A servo's control table as memory: access rights, ranges, the EEPROM lock, indirect addresses.

Reading and writing go by byte ranges as on the wire; a write is split into whole registers, with
indirect data resolved to what they point at. Side effects belong to the servo.
"""

from __future__ import annotations

import struct

from hil.config.xh430 import TABLE, TABLE_SIZE, Register
from hil.fakes.servos import protocol

GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")
_BY_ADDRESS = {r.address: r for r in TABLE.values()}
_INDIRECT = {
    TABLE[f"indirect_data_{k}"].address: TABLE[f"indirect_address_{k}"].address for k in range(1, 57)
}
_INDIRECT_FIRST = min(_INDIRECT)
_CODES = {1: "b", 2: "h", 4: "i"}
_UNPACK = {
    r.name: (struct.Struct("<" + (_CODES[r.size] if r.signed else _CODES[r.size].upper())), r.address)
    for r in TABLE.values()
}
_NOT_BACKED_UP = ("id", "baud_rate", "torque_enable", "bus_watchdog", *GOALS)

Plan = tuple[tuple[Register, int], ...]


class WriteRefused(Exception):
    """A write that the servo does not accept; `code` is the error number of its status."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def _initial() -> bytearray:
    data = bytearray(TABLE_SIZE)
    for register in TABLE.values():
        data[register.address : register.address + register.size] = register.encode(register.default)
    return data


FACTORY = bytes(_initial())


class ControlTable:
    """662 bytes with their rules.

    Attributes:
        data: the raw bytes; live registers are put here before they are read.
    """

    def __init__(self) -> None:
        self.data = bytearray(FACTORY)
        self._plans: dict[tuple[int, int], Plan] = {}

    def get(self, name: str) -> int:
        """Raw count of a register."""
        layout, address = _UNPACK[name]
        raw: int = layout.unpack_from(self.data, address)[0]
        return raw

    def put(self, name: str, raw: int) -> None:
        """Set a register without any check."""
        register = TABLE[name]
        self.data[register.address : register.address + register.size] = register.encode(raw)
        if name.startswith("indirect_address"):
            self._plans.clear()

    def read(self, address: int, length: int) -> bytes | None:
        """Bytes of a range with indirect data resolved; None beyond the table."""
        end = address + length
        if length == 0 or end > TABLE_SIZE:
            return None
        if end <= _INDIRECT_FIRST:
            return bytes(self.data[address:end])
        return bytes(self.data[self._resolve(a)] for a in range(address, end))

    def plan(self, address: int, length: int) -> Plan:
        """Whole registers, with offsets into the data, that a write of this range means.

        Raises:
            WriteRefused: undefined or cut registers.
        """
        key = (address, length)
        plan = self._plans.get(key)
        if plan is None:
            plan = self._plans[key] = self._split(address, length)
        return plan

    def check(self, register: Register, raw: int, torque: bool) -> None:
        """Raise `WriteRefused` when a register cannot take a value now."""
        if not register.writable:
            raise WriteRefused(protocol.ACCESS)
        if torque and (register.eeprom or register.name.startswith("indirect_address")):
            raise WriteRefused(protocol.ACCESS)
        if not register.permits(raw):
            raise WriteRefused(protocol.DATA_RANGE)
        if register.limit and abs(raw) > self.get(register.limit):
            raise WriteRefused(protocol.DATA_LIMIT)

    def reset_ram(self) -> None:
        """RAM as after power-up."""
        first = TABLE["torque_enable"].address
        self.data[first:] = FACTORY[first:]
        self.put("goal_pwm", self.get("pwm_limit"))
        self.put("goal_current", self.get("current_limit"))
        self._plans.clear()

    def snapshot(self) -> dict[str, int]:
        """What a control table backup keeps."""
        return {
            r.name: self.get(r.name) for r in TABLE.values() if r.writable and r.name not in _NOT_BACKED_UP
        }

    def restore(self, snapshot: dict[str, int], *, eeprom: bool) -> None:
        """Put a backup back: its RAM, and its EEPROM where asked."""
        for name, raw in snapshot.items():
            if eeprom or not TABLE[name].eeprom:
                self.put(name, raw)

    def _resolve(self, address: int) -> int:
        pointer = _INDIRECT.get(address)
        return address if pointer is None else self.data[pointer] | self.data[pointer + 1] << 8

    def _split(self, address: int, length: int) -> Plan:
        if length == 0:
            raise WriteRefused(protocol.DATA_LENGTH)
        if address + length > TABLE_SIZE:
            raise WriteRefused(protocol.ACCESS)
        targets = [self._resolve(a) for a in range(address, address + length)]
        plan, k = [], 0
        while k < length:
            register = _BY_ADDRESS.get(targets[k])
            if register is None:
                raise WriteRefused(protocol.ACCESS)
            if targets[k : k + register.size] != list(
                range(register.address, register.address + register.size)
            ):
                raise WriteRefused(protocol.DATA_LENGTH)
            plan.append((register, k))
            k += register.size
        return tuple(plan)
