"""An open serial port of a driver. Errors of pyserial become `DeviceError`."""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError
from hil.links.serial_url import PORT_ERRORS, cannot_open, close_quietly, open_serial

T = TypeVar("T")

_WAIT_S, _WRITE_S = 0.01, 0.05
_ASK_AGAIN_NS = nanoseconds(0.1)


class PortLostError(DeviceError):
    """An open port has failed: its cable or adapter is gone."""


class SerialPort:
    """A port by pyserial URL.

    Args:
        device: name in errors.
        url: device path or pyserial URL.
        baud: bits per second.
        expected: expected device, in errors.
        shared: True if another driver of this process may have the port open, too.

    Raises:
        DeviceError: the port cannot be opened.
    """

    def __init__(self, device: str, url: str, baud: int, *, expected: str, shared: bool = False) -> None:
        self._device, self.url, self.baud = device, url, baud
        self._port: Any = None
        try:
            self._port = open_serial(
                url, baud=baud, timeout_s=_WAIT_S, write_timeout_s=_WRITE_S, shared=shared
            )
            self._port.reset_input_buffer()
        except PORT_ERRORS as error:
            self.close()  # a port that fails once it is open would stay locked
            raise cannot_open(device, url, error, expected=expected) from None

    def close(self) -> None:
        """Close the port; never raises."""
        close_quietly(self._port)

    def read_available(self) -> bytes:
        """Bytes that have arrived; never waits. Raises `PortLostError`."""
        try:
            count = self._port.in_waiting
            return self._port.read(count) if count else b""
        except PORT_ERRORS as error:
            raise self._lost(error) from None

    def read_some(self) -> bytes:
        """Bytes as of `read_available`, but waits up to 10 ms for a first one. Raises `PortLostError`."""
        try:
            return bytes(self._port.read(max(1, self._port.in_waiting)))
        except PORT_ERRORS as error:
            raise self._lost(error) from None

    def write(self, data: bytes) -> None:
        """Send. Raises `PortLostError`."""
        try:
            self._port.write(data)
        except PORT_ERRORS as error:
            raise self._lost(error) from None

    def request(
        self,
        data: bytes,
        feed: Callable[[bytes], Iterable[Any]],
        answer: Callable[[Any], T | None],
        *,
        clock: Clock,
        timeout_s: float,
    ) -> T | None:
        """Send a request every 100 ms until its answer comes; None where it does not.

        Args:
            data: the request; empty to listen only.
            feed: function that makes packets or lines of bytes (`PacketParser.feed`, `LineParser.feed`).
            answer: function from a packet to the answer; None for a packet that is no answer.
            clock: clock of the bench.
            timeout_s: longest wait.

        Raises:
            PortLostError: the port has failed.
        """
        until_ns, again_ns = clock.now_ns() + nanoseconds(timeout_s), 0
        while (now_ns := clock.now_ns()) < until_ns:
            if data and now_ns >= again_ns:
                self.write(data)
                again_ns = now_ns + _ASK_AGAIN_NS
            for packet in feed(self.read_some()):
                if (found := answer(packet)) is not None:
                    return found
        return None

    def _lost(self, error: Exception) -> PortLostError:
        return PortLostError(
            self._device, f"the port has failed ({error})", port=self.url, remedy="check cable and adapter"
        )
