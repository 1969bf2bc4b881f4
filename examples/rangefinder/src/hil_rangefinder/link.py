"""An open serial port to a range finder: packets in, commands out. Vendor exceptions end here."""

from __future__ import annotations

from typing import Any

from hil.drivers.serial_url import PORT_ERRORS, cannot_open, open_serial
from hil.vocabulary.clock import Clock, nanoseconds
from hil.vocabulary.errors import DeviceError
from hil_rangefinder.packets import Answer, Lost, Packets, Reading, command_packet

_EXPECTED = "a TF-Luna at a serial port or pyserial URL"
_WAIT_S, _WRITE_S = 0.01, 0.1
_ASK_AGAIN_NS = nanoseconds(0.1)


class Link:
    """Packets over a port.

    Args:
        name: of the device, in errors.
        port: pyserial URL or device path.
        baud: of the link.
        clock: the bench clock.

    Raises:
        DeviceError: the port cannot be opened.
    """

    def __init__(self, name: str, port: str, baud: int, clock: Clock) -> None:
        self._name, self._url, self._clock = name, port, clock
        self._packets = Packets()
        try:
            self._port: Any = open_serial(port, baud=baud, timeout_s=_WAIT_S, write_timeout_s=_WRITE_S)
            self._port.reset_input_buffer()
        except PORT_ERRORS as error:
            raise cannot_open(name, port, error, expected=_EXPECTED) from None

    def close(self) -> None:
        """Let go of the port; never raises."""
        try:
            self._port.close()
        except PORT_ERRORS:
            return

    def arrived(self) -> list[Reading | Answer | Lost]:
        """Packets that have come since the last call; waits for nothing.

        Raises:
            DeviceError: the port has failed.
        """
        try:
            count = self._port.in_waiting
            return self._packets.feed(self._port.read(count)) if count else []
        except PORT_ERRORS as error:
            raise self._failed(error) from None

    def tell(self, command: int, payload: bytes = b"") -> None:
        """Send a command; its answer comes among what has `arrived`.

        Raises:
            DeviceError: the port has failed.
        """
        try:
            self._port.write(command_packet(command, payload))
        except PORT_ERRORS as error:
            raise self._failed(error) from None

    def ask(self, command: int, payload: bytes = b"", *, until_ns: int) -> bytes | None:
        """Payload of the answer to a command that is sent until it comes; None where it does not."""
        again_ns = self._clock.now_ns()
        while (now_ns := self._clock.now_ns()) < until_ns:
            if now_ns >= again_ns:
                self.tell(command, payload)
                again_ns = now_ns + _ASK_AGAIN_NS
            for packet in self._next():
                if isinstance(packet, Answer) and packet.command == command:
                    return packet.payload
        return None

    def _next(self) -> list[Reading | Answer | Lost]:
        """As `arrived`, but waits up to 10 ms for the first byte."""
        try:
            return self._packets.feed(self._port.read(max(1, self._port.in_waiting)))
        except PORT_ERRORS as error:
            raise self._failed(error) from None

    def _failed(self, error: Exception) -> DeviceError:
        return DeviceError(
            self._name, f"the port has failed ({error})", port=self._url, remedy="check cable and adapter"
        )
