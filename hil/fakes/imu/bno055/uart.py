"""UART protocol of the BNO055: request framing and status bytes.

Write `AA 00 reg len data...` -> `EE status`; read `AA 01 reg len` -> `BB len data...` or `EE status`
(Bosch BNO055 datasheet 4.7).
"""

from typing import NamedTuple

WRITE_SUCCESS, WRITE_FAIL, INVALID_ADDRESS, WRITE_DISABLED = 0x01, 0x03, 0x04, 0x05
WRONG_START, BUS_OVERRUN, MAX_LENGTH, MIN_LENGTH, CHARACTER_TIMEOUT = 0x06, 0x07, 0x08, 0x09, 0x0A

BAUD = 115_200
LONGEST = 128
CHARACTER_TIMEOUT_NS = 30_000_000


def status(code: int) -> bytes:
    """Return a two-byte status: acknowledgement or error."""
    return bytes((0xEE, code))


class Request(NamedTuple):
    """One complete request: `data` is None for a read, `length` the number of bytes to read.

    After a framing error, `error` is its status byte.
    """

    register: int = 0
    length: int = 0
    data: bytes | None = None
    error: int = 0


class RequestParser:
    """Splits a byte stream into requests; never raises and never keeps more than one frame."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._last_ns = 0
        self._in_noise = False

    def reset(self) -> None:
        """Drop an incomplete request."""
        self._buffer.clear()
        self._in_noise = False

    def expires_ns(self) -> int | None:
        """Time at which the incomplete request times out; None without one."""
        return self._last_ns + CHARACTER_TIMEOUT_NS if self._buffer else None

    def expire(self, t_ns: int) -> bool:
        """Drop an incomplete request that has timed out; True if there was one."""
        if self._buffer and t_ns - self._last_ns >= CHARACTER_TIMEOUT_NS:
            self.reset()
            return True
        return False

    def feed(self, data: bytes, t_ns: int) -> list[Request]:
        """Return the requests that `data` completes; its last byte arrived at `t_ns`."""
        self._last_ns = t_ns
        if (
            not self._buffer
            and len(data) == 4
            and data[0] == 0xAA
            and data[1] == 1
            and 0 < data[3] <= LONGEST
        ):
            self._in_noise = False
            return [Request(data[2], data[3], None, 0)]
        self._buffer += data
        found: list[Request] = []
        while self._buffer:
            request = self._take()
            if request is None:
                break
            if request.error != WRONG_START or not self._in_noise:
                found.append(request)
            self._in_noise = request.error == WRONG_START
        self._in_noise = self._in_noise and bool(self._buffer)
        return found

    def _take(self) -> Request | None:
        buffer = self._buffer
        if buffer[0] != 0xAA:
            return self._drop(1, WRONG_START)
        if len(buffer) > 1 and buffer[1] > 1:
            return self._drop(2, WRONG_START)
        if len(buffer) < 4:
            return None
        writing, register, length = buffer[1] == 0, buffer[2], buffer[3]
        if length == 0:
            return self._drop(4, MIN_LENGTH)
        if length > LONGEST:
            return self._drop(len(buffer) if writing else 4, MAX_LENGTH)
        if not writing:
            del buffer[:4]
            return Request(register, length)
        if len(buffer) < 4 + length:
            return None
        payload = bytes(buffer[4 : 4 + length])
        del buffer[: 4 + length]
        return Request(register, length, payload)

    def _drop(self, count: int, error: int) -> Request:
        del self._buffer[:count]
        return Request(error=error)
