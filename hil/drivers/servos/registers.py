"""Where the driver finds in a model's control table what it reads and writes."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from hil.config.servo_models import Register, ServoModel

CYCLE_FIELDS = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
"""What every cycle reads."""

FULL_LEVEL = 2
"""Return level at which a servo answers everything; a full look through a lost map shows zero instead."""

AUDIT_LENGTH = 3
_GOAL_LENGTH = 4
_CYCLE = ("present_current", "present_velocity", "present_position")
_HEALTH = ("present_input_voltage", "present_temperature")
_FULL = {
    "torque": ("u1", "torque_enable"),
    "watchdog": ("u1", "bus_watchdog"),
    "error": ("u1", "hardware_error_status"),
    "level": ("u1", "status_return_level"),
    "current": ("<i2", _CYCLE[0]),
    "velocity": ("<i4", _CYCLE[1]),
    "position": ("<i4", _CYCLE[2]),
    "voltage": ("<u2", _HEALTH[0]),
    "temperature": ("u1", _HEALTH[1]),
}
FULL_FIELDS = np.dtype([(name, kind) for name, (kind, _) in _FULL.items()])
"""What a full look shows, as the indirect data have it, one behind the other."""


class RegisterMap:
    """Addresses in the control table of one model.

    Attributes:
        model: whose table it is.
        torque, hardware_error, watchdog, goal_velocity, goal_position: of these registers.
        cycle_address, cycle_length: current, velocity and position, one range.
        indirect_address: of the first; what they point at stands at `goal_data` and on.
        audit_data, direct_audit, direct_audit_length: of an audit, through the indirect data and without.
        direct_full_length, direct_full_fields: of a full look without the indirect data, from `torque` on.
    """

    def __init__(self, model: ServoModel) -> None:
        self.model = model
        table = self._table = model.table
        self.torque = table["torque_enable"].address
        self.hardware_error = table["hardware_error_status"].address
        self.watchdog = table["bus_watchdog"].address
        self.goal_velocity = table["goal_velocity"].address
        self.goal_position = table["goal_position"].address
        self.cycle_address, self.cycle_length = _range(table, _CYCLE)
        self._health = _range(table, _HEALTH)
        self.indirect_address = table["indirect_address_1"].address
        self.goal_data = table["indirect_data_1"].address
        self.audit_data = self.goal_data + _GOAL_LENGTH
        self.direct_audit, self.direct_audit_length = self.torque, self.watchdog - self.torque + 1
        self.direct_full_length = sum(self._health) - self.torque
        self.direct_full_fields = np.dtype(
            {
                "names": list(_FULL),
                "formats": [kind for kind, _ in _FULL.values()],
                "offsets": [table[register].address - self.torque for _, register in _FULL.values()],
                "itemsize": self.direct_full_length,
            }
        )

    def indirect_map(self, goal_address: int) -> bytes:
        """Indirect Address 1..21: four bytes of a goal, then what a full look shows (`FULL_FIELDS`)."""
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
