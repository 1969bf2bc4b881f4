"""Decodes group instructions (sync and bulk): addressed servos and their data."""

from collections.abc import Callable

from hil.fakes.servos.dynamixel import protocol
from hil.fakes.servos.dynamixel.protocol import Instruction

Wanted = list[tuple[int, int, int]]
"""(ID, address, length) in the order of the request."""


def pair(data: bytes) -> tuple[int, int]:
    """Decode two little-endian words: address and length."""
    return data[0] | data[1] << 8, data[2] | data[3] << 8


def _sync_wanted(instruction: Instruction) -> Wanted:
    parameters = instruction.parameters
    if instruction.servo_id != protocol.BROADCAST or len(parameters) < 5:
        return []
    address, length = pair(parameters)
    return [(servo_id, address, length) for servo_id in parameters[4:]]


def _bulk_wanted(instruction: Instruction) -> Wanted:
    parameters = instruction.parameters
    if instruction.servo_id != protocol.BROADCAST or len(parameters) % 5:
        return []
    return [(parameters[k], *pair(parameters[k + 1 : k + 5])) for k in range(0, len(parameters), 5)]


def write_parts(instruction: Instruction) -> list[tuple[int, int, bytes]]:
    """Return (ID, address, data) of a sync or bulk write; truncated or malformed parts are left out."""
    parameters: bytes = instruction.parameters
    parts: list[tuple[int, int, bytes]] = []
    if instruction.servo_id != protocol.BROADCAST:
        return parts
    if instruction.code == protocol.SYNC_WRITE:
        if len(parameters) < 4:
            return parts
        address, length = pair(parameters)
        step = length + 1
        for k in range(4, len(parameters) - length, step):
            parts.append((parameters[k], address, parameters[k + 1 : k + step]))
        return parts
    k = 0
    while k + 5 <= len(parameters):
        address, length = pair(parameters[k + 1 : k + 5])
        data = parameters[k + 5 : k + 5 + length]
        if len(data) == length:
            parts.append((parameters[k], address, data))
        k += 5 + length
    return parts


GROUP_READS: dict[int, Callable[[Instruction], Wanted]] = {
    protocol.SYNC_READ: _sync_wanted,
    protocol.FAST_SYNC_READ: _sync_wanted,
    protocol.BULK_READ: _bulk_wanted,
    protocol.FAST_BULK_READ: _bulk_wanted,
}
