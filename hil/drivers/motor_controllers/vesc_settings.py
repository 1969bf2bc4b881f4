"""The settings that a VESC reports: firmware, timeout, status messages.

As in its firmware (`comm/commands.c`). Questions and answers travel in `PROCESS_SHORT_BUFFER` frames; a long
answer comes in pieces that are closed by length and checksum. The settings begin alike since firmware 5.03.
"""

import struct
from dataclasses import dataclass

from fastcrc import crc16

FILL, FILL_LONG, PROCESS, SHORT = 5, 6, 7, 8
_FW_VERSION, _GET_APPCONF = 0, 17
_HEAD = struct.Struct(">BIBIIHHBB")
_MOST_BYTES = 1024
_STATUSES = 6
QUESTIONS = (_FW_VERSION, _GET_APPCONF)


@dataclass(frozen=True)
class Settings:
    """Settings of a controller, as set in VESC Tool (App Settings, General).

    Attributes:
        controller_id: its id.
        timeout_s: time without a command after which it releases the motor.
        rates_hz, messages: rates and message numbers of its two groups of status messages.
    """

    controller_id: int
    timeout_s: float
    rates_hz: tuple[int, int]
    messages: tuple[frozenset[int], frozenset[int]]

    @property
    def sent(self) -> frozenset[int]:
        """Numbers of the status messages that it sends at a rate above 0."""
        pairs = zip(self.rates_hz, self.messages, strict=True)
        return frozenset(number for rate, which in pairs if rate > 0 for number in which)


def question(kind: int, own_id: int) -> bytes:
    """Data of a request frame; the answer is addressed to `own_id`."""
    return bytes((own_id, 0, kind))


class Answers:
    """Reassembles answers from frames.

    Attributes:
        firmware: `6.05`, once reported.
        settings: settings, once reported.
    """

    def __init__(self) -> None:
        self._buffer = bytearray(_MOST_BYTES)
        self.firmware = ""
        self.settings: Settings | None = None

    @property
    def complete(self) -> bool:
        """Whether everything has been reported."""
        return bool(self.firmware) and self.settings is not None

    def take(self, command: int, data: bytes) -> None:
        """Take a frame that is addressed to the asker."""
        if command == FILL and data:
            self._put(data[0], data[1:])
        elif command == FILL_LONG and len(data) >= 2:
            self._put(int.from_bytes(data[:2], "big"), data[2:])
        elif command == SHORT and len(data) > 2:
            self._understand(bytes(data[2:]))
        elif command == PROCESS and len(data) >= 6:
            length, checksum = struct.unpack_from(">HH", data, 2)
            payload = bytes(self._buffer[:length])
            if length <= _MOST_BYTES and crc16.xmodem(payload) == checksum:
                self._understand(payload)

    def _put(self, at: int, piece: bytes) -> None:
        if at + len(piece) <= _MOST_BYTES:
            self._buffer[at : at + len(piece)] = piece

    def _understand(self, payload: bytes) -> None:
        kind = payload[0] if payload else None  # a long answer of no bytes has the right checksum, too: 0
        if kind == _FW_VERSION and len(payload) >= 3:
            self.firmware = f"{payload[1]}.{payload[2]:02d}"
        elif kind == _GET_APPCONF and len(payload) >= _HEAD.size:
            _, _, own, timeout_ms, _, rate_1, rate_2, mask_1, mask_2 = _HEAD.unpack_from(payload)
            masks = tuple(
                frozenset(n + 1 for n in range(_STATUSES) if mask >> n & 1) for mask in (mask_1, mask_2)
            )
            self.settings = Settings(own, timeout_ms / 1000.0, (rate_1, rate_2), (masks[0], masks[1]))
