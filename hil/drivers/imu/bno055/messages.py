"""Request and reply with a BNO055 over a pyserial port: framing, error codes, bounded repetition.

Two bytes are read first, then the rest: a plain `read(2 + n)` would wait its whole timeout on a
two-byte error reply (Bosch BNO055 datasheet 4.7). Exceptions of pyserial become `ExchangeError`.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from hil.config.imu import Bno055Config
from hil.core.clock import Clock, nanoseconds
from hil.core.signals import Status
from hil.links.serial_url import PORT_ERRORS, cannot_open, close_quietly, open_serial

READ, WRITE = 0x01, 0x00
STATUS_TEXT = {
    0x02: "read failed",
    0x03: "write failed",
    0x04: "invalid register address",
    0x05: "register write disabled",
    0x06: "wrong start byte",
    0x07: "bus overrun",
    0x08: "longest length exceeded",
    0x09: "shortest length undercut",
    0x0A: "receive character timeout",
}
_WRITTEN = 0x01
_MAX_ATTEMPTS = 10
_PATIENCE_S = 0.04
_NONE = -1


class ExchangeError(Exception):
    """One exchange failed; stays inside this package."""

    def __init__(self, status: Status, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


class Link:
    """An open port to one chip.

    Attributes: asked_ns: time at which the latest request was handed to the port. port_failures: exchanges in
    a row in which the port itself failed.
    """

    def __init__(self, config: Bno055Config, clock: Clock, name: str) -> None:
        self._clock, self._name, self.port_name = clock, name, config.port
        self._gap_ns = nanoseconds(config.retry_gap_s)
        self._dirty = True
        self._ahead = b""
        self._length = self._owed_length = _NONE
        self.asked_ns = self.port_failures = 0
        try:
            self._port: Any = open_serial(
                config.port,
                baud=config.baud,
                timeout_s=config.reply_timeout_s,
                write_timeout_s=max(config.reply_timeout_s, 0.1),
            )
        except PORT_ERRORS as error:
            expected = "a BNO055 in UART mode at a serial port or pyserial URL"
            raise cannot_open(name, config.port, error, expected=expected) from None

    @contextmanager
    def patient(self) -> Iterator[None]:
        """Allow longer reply times within the context, for a busy host; not for the control cycle."""
        before_s = self._port.timeout
        self._port.timeout = before_s + _PATIENCE_S
        try:
            yield
        finally:
            with suppress(*PORT_ERRORS):
                self._port.timeout = before_s

    def close(self) -> None:
        """Close the port; never raises."""
        close_quietly(self._port)

    def read(self, register: int, length: int, deadline_ns: int) -> bytes:
        """Read registers, repeating what can end by `deadline_ns`; raises `ExchangeError`."""
        return self._repeat(bytes((0xAA, READ, register, length)), length, deadline_ns)

    def write(self, register: int, data: bytes, deadline_ns: int) -> None:
        """Write registers, repeating what can end by `deadline_ns`; raises `ExchangeError`."""
        self._repeat(bytes((0xAA, WRITE, register, len(data))) + data, 0, deadline_ns)

    def ask_ahead(self, register: int, length: int) -> None:
        """Send a read request now; a later `read` of the same registers takes its reply."""
        request = bytes((0xAA, READ, register, length))
        try:
            self._send(request)
        except PORT_ERRORS:
            return
        self._ahead = request

    def under_way(self, patience_ns: int) -> bool:
        """Whether a request was sent ahead less than `patience_ns` ago and no reply byte has come yet."""
        if not self._ahead or self._clock.now_ns() - self.asked_ns >= patience_ns:
            return False
        try:
            return not self._port.in_waiting
        except PORT_ERRORS:
            return False

    def _send(self, request: bytes) -> None:
        self._owed_length = self._length if self._dirty else _NONE
        if self._dirty:
            self._port.reset_input_buffer()
        self._dirty = True
        self._length = request[3] if request[1] == READ else 0
        self.asked_ns = self._clock.now_ns()
        self._port.write(request)

    def _waited_out(self) -> bool:
        return self._clock.now_ns() - self.asked_ns >= nanoseconds(self._port.timeout)

    def _is_late(self, head: bytes, length: int) -> bool:
        """Whether the reply to the request before, which has timed out, begins: the chip answers in turn."""
        return len(head) == 2 and head[0] == 0xBB and head[1] == self._owed_length != length

    def _repeat(self, request: bytes, length: int, deadline_ns: int) -> bytes:
        left = _MAX_ATTEMPTS
        while True:
            left -= 1
            try:
                return self._exchange(request, length)
            except ExchangeError:
                again_ns = self._clock.now_ns() + self._gap_ns
                if not left or again_ns + nanoseconds(self._port.timeout) > deadline_ns:
                    raise
            self._clock.sleep_until_ns(again_ns)

    def _exchange(self, request: bytes, length: int) -> bytes:
        try:
            waiting, self._ahead = self._ahead == request, b""
            if not waiting:
                self._send(request)
            elif self._waited_out() and not self._port.in_waiting:
                raise ExchangeError(Status.TIMEOUT, "no reply before the timeout")
            head = self._port.read(2)
            if self._is_late(head, length):
                self._port.read(head[1])
                head = self._port.read(2)
            if len(head) < 2:
                raise ExchangeError(Status.TIMEOUT, f"{len(head)} of 2 header bytes before the timeout")
            if head[0] == 0xBB and length and head[1] == length:
                data: bytes = self._port.read(length)
                if len(data) < length:
                    raise ExchangeError(Status.TIMEOUT, f"{len(data)} of {length} data bytes")
                self._dirty, self.port_failures = self._owed_length == length, 0
                return data
        except PORT_ERRORS as error:
            self.port_failures += 1
            raise ExchangeError(Status.TIMEOUT, f"the port failed ({error})") from None
        self.port_failures = 0
        if head[0] == 0xEE:
            self._dirty = False
            if head[1] == _WRITTEN and not length:
                return b""
            text = STATUS_TEXT.get(head[1], "unknown status")
            raise ExchangeError(Status.PROTOCOL, f"error reply 0x{head[1]:02X} ({text})")
        raise ExchangeError(Status.PROTOCOL, f"unexpected reply {head.hex(' ')}")
