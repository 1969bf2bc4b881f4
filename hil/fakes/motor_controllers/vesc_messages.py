"""CAN frames of the emulated controller, written from the firmware's sources (`comm/comm_can.c`).

Extended identifiers, `command << 8 | id`; big endian. The driver shares no code with this module: a test
checks both against the same bytes.
"""

import struct
from collections.abc import Iterator

SET_COMMANDS = {0: 1e5, 1: 1e3, 2: 1e3, 3: 1.0, 4: 1e6, 10: 1e5, 11: 1e5, 12: 1e3, 13: 1e5}
"""Commands that set something, and their resolution per unit."""
SET_DUTY, SET_CURRENT, SET_RPM, SET_CURRENT_REL = 0, 1, 3, 10
SHORT_BUFFER, PING, PONG, ALL_SERVOS = 8, 17, 18, 255
FILL_BUFFER, PROCESS_BUFFER = 5, 7
FW_VERSION, GET_APPCONF = 0, 17
_ANSWER = 1
_SIGNATURE = 0x2D5E3F77

Outgoing = tuple[int, bytes]


def command_value(command: int, data: bytes) -> float | None:
    """Decode the value of a `SET_*` command; None if the frame is too short."""
    if len(data) < 4:
        return None
    return float(struct.unpack_from(">i", data)[0]) / SET_COMMANDS[command]


def clipped(value: float, bits: int) -> int:
    """Round to an integer and saturate at the range of a signed integer of `bits` bits."""
    top, figure = (1 << (bits - 1)) - 1, round(value)
    return figure if -top <= figure <= top else min(max(figure, -top - 1), top)


def status_1(erpm: float, motor_a: float, duty: float) -> bytes:
    """Encode status message 1: electrical speed, motor current and duty."""
    return struct.pack(">ihh", clipped(erpm, 32), clipped(motor_a * 10, 16), clipped(duty * 1000, 16))


def status_2_or_3(used: float) -> bytes:
    """Encode status message 2 (charge drawn, Ah) or 3 (energy drawn, Wh); the charged value is 0."""
    return struct.pack(">ii", clipped(used * 1e4, 32), 0)


def status_4(fet_c: float, motor_c: float, input_a: float) -> bytes:
    """Encode status message 4: temperatures and input current."""
    return struct.pack(
        ">hhhh", clipped(fet_c * 10, 16), clipped(motor_c * 10, 16), clipped(input_a * 10, 16), 0
    )


def status_5(tachometer: float, input_v: float) -> bytes:
    """Encode status message 5: tachometer (wraps at 32 bits) and input voltage."""
    wrapped = (round(tachometer) + (1 << 31)) % (1 << 32) - (1 << 31)
    return struct.pack(">ihh", wrapped, clipped(input_v * 10, 16), 0)


def status_6() -> bytes:
    """Encode status message 6: nothing is connected to the analogue and pulse inputs."""
    return bytes(8)


def firmware_reply(version: str) -> bytes:
    """Encode the reply to a firmware query: version (two numbers), name of the hardware, 12-byte id."""
    major, _, minor = version.partition(".")
    return bytes((FW_VERSION, int(major), int(minor or 0))) + b"emulated\0" + bytes(range(12))


def settings_reply(
    controller_id: int, timeout_s: float, rates_hz: tuple[float, float], masks: tuple[int, int]
) -> bytes:
    """Encode the reply to a settings query: the first fields as firmware 6 sends them."""
    return struct.pack(
        ">BIBIIHHBBB",
        GET_APPCONF,
        _SIGNATURE,
        controller_id,
        round(1000 * timeout_s),
        0,
        round(rates_hz[0]),
        round(rates_hz[1]),
        *masks,
        2,
    ) + bytes(64)


def in_pieces(own_id: int, asker_id: int, payload: bytes) -> Iterator[Outgoing]:
    """Split a reply into frames; a long one ends with a frame of its length and checksum."""
    if len(payload) <= 6:
        yield SHORT_BUFFER << 8 | asker_id, bytes((own_id, _ANSWER)) + payload
        return
    for at in range(0, len(payload), 7):
        yield FILL_BUFFER << 8 | asker_id, bytes((at,)) + payload[at : at + 7]
    tail = struct.pack(">BBHH", own_id, _ANSWER, len(payload), _crc16(payload))
    yield PROCESS_BUFFER << 8 | asker_id, tail


def _crc16(data: bytes) -> int:
    """CRC-16 with polynomial 0x1021 from 0 (XMODEM)."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc
