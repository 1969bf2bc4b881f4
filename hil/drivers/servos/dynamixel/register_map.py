"""The blocks of a model's control table that the driver reads and writes."""

import struct
from collections.abc import Mapping
from itertools import pairwise

from hil.config.servo_models import Register, ServoModel

FULL_LEVEL = 2
"""Status Return Level of answers to all instructions; a full read through a lost map shows 0 instead."""

AUDIT_LENGTH = 3
_GOAL_LENGTH = 4
_CYCLE = ("present_current", "present_velocity", "present_position")
_HEALTH = ("present_input_voltage", "present_temperature")
_FULL = {
    "torque": ("B", "torque_enable"),
    "watchdog": ("B", "bus_watchdog"),
    "error": ("B", "hardware_error_status"),
    "level": ("B", "status_return_level"),
    "current": ("h", _CYCLE[0]),
    "velocity": ("i", _CYCLE[1]),
    "position": ("i", _CYCLE[2]),
    "voltage": ("H", _HEALTH[0]),
    "temperature": ("B", _HEALTH[1]),
}


class Fields:
    """Registers in one range of bytes.

    Args:
        kinds: `struct` code of each register, by name, in the order of the range.
        places: offset of each in the range; one behind the other when None.
        length: bytes of the range; up to the end of the last register when 0.

    Attributes:
        names: names of the registers, in the order of the range.
        length: bytes of the range.
        form: `struct` format of the range.
    """

    def __init__(
        self, kinds: Mapping[str, str], places: Mapping[str, int] | None = None, length: int = 0
    ) -> None:
        self.names, at, form = tuple(kinds), 0, []
        for name, kind in kinds.items():
            place = at if places is None else places[name]
            form.append(f"{place - at}x{kind}")
            at = place + struct.calcsize(kind)
        self.length = length or at
        self.form = "".join(form) + f"{self.length - at}x"
        self._unpack = struct.Struct("<" + self.form).unpack

    def of(self, data: bytes) -> dict[str, int]:
        """Raw counts by name in `length` bytes."""
        return dict(zip(self.names, self._unpack(data), strict=True))


CYCLE_FIELDS = Fields({"current": "h", "velocity": "i", "position": "i"})
"""Registers that every cycle reads."""

FULL_FIELDS = Fields({name: kind for name, (kind, _) in _FULL.items()})
"""Registers of a full read, in the order of the indirect data, one behind the other."""


class RegisterMap:
    """Addresses in the control table of one model.

    Attributes:
        model: the model with this table.
        torque, hardware_error, watchdog, goal_velocity: addresses of these registers.
        goal_addresses: address of each joint's goal: the drives' velocity, the steers' position.
        cycle_address, cycle_length: current, velocity and position, one range.
        indirect_address: address of Indirect Address 1; the data they point at begin at `goal_data`.
        audit_data, direct_audit, direct_audit_length: addresses and length of an audit, through the indirect
            data and without.
        direct_full_fields: fields of a full read without the indirect data, from `torque` on.
    """

    def __init__(self, model: ServoModel) -> None:
        self.model = model
        table = self._table = model.table
        self.torque = table["torque_enable"].address
        self.hardware_error = table["hardware_error_status"].address
        self.watchdog = table["bus_watchdog"].address
        self.goal_velocity = table["goal_velocity"].address
        self.goal_addresses = [self.goal_velocity] * 4 + [table["goal_position"].address] * 4
        self.cycle_address, self.cycle_length = _range(table, _CYCLE)
        self._health = _range(table, _HEALTH)
        self.indirect_address = table["indirect_address_1"].address
        self.goal_data = table["indirect_data_1"].address
        self.audit_data = self.goal_data + _GOAL_LENGTH
        self.direct_audit, self.direct_audit_length = self.torque, self.watchdog - self.torque + 1
        places = {name: table[register].address - self.torque for name, (_, register) in _FULL.items()}
        names = sorted(places, key=places.__getitem__)
        self.direct_full_fields = Fields(
            {name: _FULL[name][0] for name in names}, places, sum(self._health) - self.torque
        )

    def indirect_map(self, goal_address: int) -> bytes:
        """Indirect Address 1..21: four bytes of a goal, then the registers of a full read (`FULL_FIELDS`)."""
        shown = (self._table[register] for _, register in _FULL.values())
        targets = [*range(goal_address, goal_address + _GOAL_LENGTH)]
        for register in shown:
            targets += range(register.address, register.end)
        return b"".join(t.to_bytes(2, "little") for t in targets)

    def audit_values(self, data: bytes) -> tuple[int, int, int]:
        """(torque, watchdog, hardware error) of an audit read, through the map or of the whole range."""
        if len(data) == AUDIT_LENGTH:
            return data[0], data[1], data[2]
        return data[0], data[self.watchdog - self.torque], data[self.hardware_error - self.torque]

    def from_block(self, block: bytes, name: str) -> int:
        """Raw count of a register in a block read from address 0."""
        return from_block(block, self._table[name])

    def encoded(self, registers: Mapping[str, int]) -> list[tuple[int, bytes]]:
        """(address, data) of named registers, by address."""
        pairs = [(self._table[name], raw) for name, raw in registers.items()]
        return sorted((register.address, register.encode(raw)) for register, raw in pairs)


def from_block(block: bytes, register: Register) -> int:
    """Raw count of a register in a block read from address 0."""
    return register.decode(block[register.address : register.end])


def _range(table: Mapping[str, Register], names: tuple[str, ...]) -> tuple[int, int]:
    """(address, length) of registers that lie one behind the other."""
    registers = [table[name] for name in names]
    for before, after in pairwise(registers):
        if before.end != after.address:
            raise LookupError(f"{before.name} and {after.name} are not neighbours")
    return registers[0].address, registers[-1].end - registers[0].address
