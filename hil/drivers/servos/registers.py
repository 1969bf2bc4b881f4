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
HEALTH_ADDRESS, HEALTH_LENGTH = TABLE["present_input_voltage"].address, 3
HEALTH_FIELDS = np.dtype([("voltage", "<u2"), ("temperature", "u1")])

INDIRECT_ADDRESS = TABLE["indirect_address_1"].address
GOAL_DATA = TABLE["indirect_data_1"].address
AUDIT_DATA, AUDIT_LENGTH = TABLE["indirect_data_5"].address, 3
_AUDITED = (TORQUE, WATCHDOG, HARDWARE_ERROR)
DIRECT_AUDIT, DIRECT_AUDIT_LENGTH = TORQUE, WATCHDOG - TORQUE + 1

BLOCK_LENGTH = TABLE["backup_ready"].address + 1


def indirect_map(goal_address: int) -> bytes:
    """Indirect Address 1..7: four bytes of a goal, then torque, watchdog and hardware error."""
    targets = (*range(goal_address, goal_address + 4), *_AUDITED)
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
