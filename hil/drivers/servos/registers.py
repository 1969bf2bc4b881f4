"""Addresses that the driver uses, looked up once in the control table, and encoders of named registers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil.config.xh430 import TABLE

TORQUE = TABLE["torque_enable"].address
RETURN_LEVEL = TABLE["status_return_level"].address
HARDWARE_ERROR = TABLE["hardware_error_status"].address
WATCHDOG = TABLE["bus_watchdog"].address
GOAL_VELOCITY = TABLE["goal_velocity"].address
GOAL_POSITION = TABLE["goal_position"].address
BAUD_RATE = TABLE["baud_rate"].address
ID = TABLE["id"].address

CYCLE_ADDRESS, CYCLE_LENGTH = TABLE["present_current"].address, 10
CYCLE_FIELDS = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])

INDIRECT_ADDRESS = TABLE["indirect_address_1"].address
GOAL_DATA = TABLE["indirect_data_1"].address
AUDIT_DATA, AUDIT_LENGTH = TABLE["indirect_data_5"].address, 3
_AUDITED = (TORQUE, WATCHDOG, HARDWARE_ERROR)
DIRECT_AUDIT, DIRECT_AUDIT_LENGTH = TORQUE, WATCHDOG - TORQUE + 1

FULL_LEVEL = 2
"""Return level at which a servo answers everything; a full look through a lost map shows zero instead."""

_VOLTAGE = TABLE["present_input_voltage"].address
_HEALTH_LENGTH = 3
_FULL_FIELDS = {
    "torque": ("u1", TORQUE),
    "watchdog": ("u1", WATCHDOG),
    "error": ("u1", HARDWARE_ERROR),
    "level": ("u1", RETURN_LEVEL),
    "current": ("<i2", CYCLE_ADDRESS),
    "velocity": ("<i4", CYCLE_ADDRESS + 2),
    "position": ("<i4", CYCLE_ADDRESS + 6),
    "voltage": ("<u2", _VOLTAGE),
    "temperature": ("u1", _VOLTAGE + 2),
}
FULL_FIELDS = np.dtype([(name, kind) for name, (kind, _) in _FULL_FIELDS.items()])
DIRECT_FULL_LENGTH = _VOLTAGE + _HEALTH_LENGTH - TORQUE
DIRECT_FULL_FIELDS = np.dtype(
    {
        "names": list(_FULL_FIELDS),
        "formats": [kind for kind, _ in _FULL_FIELDS.values()],
        "offsets": [address - TORQUE for _, address in _FULL_FIELDS.values()],
        "itemsize": DIRECT_FULL_LENGTH,
    }
)

BLOCK_LENGTH = TABLE["backup_ready"].address + 1


def indirect_map(goal_address: int) -> bytes:
    """Indirect Address 1..21: four bytes of a goal, then what a full look shows (`FULL_FIELDS`)."""
    motion = range(CYCLE_ADDRESS, CYCLE_ADDRESS + CYCLE_LENGTH)
    health = range(_VOLTAGE, _VOLTAGE + _HEALTH_LENGTH)
    targets = (*range(goal_address, goal_address + 4), *_AUDITED, RETURN_LEVEL, *motion, *health)
    return b"".join(t.to_bytes(2, "little") for t in targets)


def audit_values(data: bytes) -> tuple[int, int, int]:
    """(torque, watchdog, hardware error) of an audit read, through the map or of the whole range."""
    if len(data) == AUDIT_LENGTH:
        return data[0], data[1], data[2]
    return data[0], data[WATCHDOG - TORQUE], data[HARDWARE_ERROR - TORQUE]


def from_block(block: bytes, name: str) -> int:
    """Raw count of a register in a block read from address 0."""
    register = TABLE[name]
    return register.decode(block[register.address : register.address + register.size])


def encoded(registers: Mapping[str, int]) -> list[tuple[int, bytes]]:
    """(address, data) of named registers, by address."""
    pairs = [(TABLE[name].address, TABLE[name].encode(raw)) for name, raw in registers.items()]
    return sorted(pairs)
