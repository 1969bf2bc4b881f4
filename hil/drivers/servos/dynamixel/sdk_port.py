"""The SDK's port on any pyserial URL and on the injected clock.

The stock `PortHandler` opens local devices only, polls with a timeout of zero (one core at 99 %),
measures on the wall clock and waits 34 ms for a missing servo. This one
blocks in the serial read, and computes its timeouts from baud rate, bytes, return delay and latency.
"""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dynamixel_sdk import PortHandler

from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.links.serial_url import PORT_ERRORS, cannot_open, close_quietly, open_serial

_BITS = 10
_SMALLEST_TIMEOUT_S = 1e-4
_TIMEOUT_STEP_S = 5e-4
_PATIENCE_S = 0.02
_GONE = (errno.EIO, errno.ENODEV, errno.ENOENT, errno.ENXIO)
_COMES_BACK_NS, _PAUSE_NS = nanoseconds(1.5), nanoseconds(0.1)


class PortLost(Exception):
    """The open port has failed (unplugged, closed); stays inside this package."""


class ServoPort(PortHandler):  # type: ignore[misc]
    """An open serial port with Dynamixel's rates.

    Args:
        url: any pyserial URL or device path.
        baud: bits per second.
        clock: the bench clock.
        latency_s: latency timer of the USB adapter.
        slack_s: silence beyond the computed time before a reply counts as lost.

    Attributes:
        return_delay_s: longest of the servos', part of a reply's time.
    """

    def __init__(self, url: str, baud: int, clock: Clock, *, latency_s: float, slack_s: float) -> None:
        super().__init__(url)
        self.ser: Any = None
        self.is_open: bool = False
        self.baudrate: int = baud
        self.return_delay_s = 508e-6
        self._clock = clock
        self._patience_s = 0.0
        self._latency_s = latency_s
        self._wait_s = latency_s + slack_s
        self._sent_ns = 0
        self._deadline_ns = 0
        self._timeout_s = -1.0
        self._on_wire_ns: dict[int, int] = {}

    def open(self, device: str) -> None:
        """Open the port; waits up to 1.5 s for one that is gone, as a pulled adapter may come back.

        Raises:
            DeviceError: the port cannot be opened; with a remedy.
        """
        end_ns = self._clock.now_ns() + _COMES_BACK_NS
        while True:
            try:
                self.ser = open_serial(
                    self.port_name, baud=self.baudrate, timeout_s=_SMALLEST_TIMEOUT_S, write_timeout_s=1.0
                )
                self.is_open = True
                self.ser.reset_input_buffer()
                return
            except PORT_ERRORS as error:
                self.closePort()
                now_ns = self._clock.now_ns()
                if getattr(error, "errno", None) not in _GONE or now_ns >= end_ns:
                    expected = "a DYNAMIXEL bus at a serial port or pyserial URL"
                    raise cannot_open(device, self.port_name, error, expected=expected) from None
            self._clock.sleep_until_ns(now_ns + _PAUSE_NS)

    def setBaudRate(self, baudrate: int) -> bool:
        """Change the baud rate of the open port; raises `PortLost`."""
        try:
            self.ser.baudrate = baudrate
            self.ser.reset_input_buffer()
        except PORT_ERRORS as error:
            raise PortLost(str(error)) from None
        self.baudrate = baudrate
        self._on_wire_ns.clear()
        return True

    def closePort(self) -> None:
        """Close the port; never raises."""
        ser, self.ser, self.is_open, self.is_using = self.ser, None, False, False
        close_quietly(ser)

    def wire_s(self, count: int) -> float:
        """Time of `count` bytes on the wire."""
        return count * _BITS / self.baudrate

    def wire_ns(self, count: int) -> int:
        """Time of `count` bytes on the wire, ns."""
        found = self._on_wire_ns.get(count)
        if found is None:
            found = self._on_wire_ns[count] = nanoseconds(self.wire_s(count))
        return found

    @contextmanager
    def patient(self) -> Iterator[None]:
        """Allow longer reply times within the context, for a busy host; not for the control cycle."""
        before, self._patience_s = self._patience_s, _PATIENCE_S
        try:
            yield
        finally:
            self._patience_s = before

    def reply_s(self, sent: int, expected: int, delays: int = 1) -> float:
        """Longest time from a request of `sent` bytes to the end of a reply of `expected`, s."""
        wait_s = self._wait_s + self._patience_s
        return self.wire_s(sent + expected) + delays * self.return_delay_s + wait_s

    def answer_ns(self, count: int) -> int:
        """Time from the end of a request until `count` bytes of answer are here, by wire and adapter."""
        return nanoseconds(self.wire_s(count) + self.return_delay_s + self._latency_s)

    def backlog_ns(self) -> int:
        """Time until the last byte written has left: what is written now is sent only then."""
        left_ns = self._sent_ns - self._clock.now_ns()
        return left_ns if left_ns > 0 else 0

    def waiting(self) -> int:
        """How many bytes wait to be read; raises `PortLost`."""
        try:
            count: int = self.ser.in_waiting
        except PORT_ERRORS as error:
            raise PortLost(str(error)) from None
        return count

    def clearPort(self) -> None:
        """Throw away what has arrived; raises `PortLost`."""
        try:
            self.ser.reset_input_buffer()
        except PORT_ERRORS as error:
            raise PortLost(str(error)) from None

    def writePort(self, packet: bytes | list[int]) -> int:
        """Send; raises `PortLost`."""
        now_ns = self._clock.now_ns()
        begins_ns = now_ns if now_ns > self._sent_ns else self._sent_ns
        self._sent_ns = begins_ns + self.wire_ns(len(packet))
        try:
            sent: int = self.ser.write(packet if isinstance(packet, bytes) else bytes(packet))
        except PORT_ERRORS as error:
            raise PortLost(str(error)) from None
        return sent

    def readPort(self, length: int) -> bytes:
        """Wait for `length` bytes until the packet's deadline; raises `PortLost`."""
        left_s = (self._deadline_ns - self._clock.now_ns()) / NS_PER_S
        return self.receive(length, left_s)

    def receive(self, length: int, timeout_s: float) -> bytes:
        """Wait for `length` bytes `timeout_s` or half a millisecond more; raises `PortLost`.

        Setting a timeout configures the whole terminal again, so one that is about right is kept.
        """
        try:
            if not timeout_s <= self._timeout_s <= timeout_s + _TIMEOUT_STEP_S:
                self._timeout_s = max(timeout_s, _SMALLEST_TIMEOUT_S) + 0.5 * _TIMEOUT_STEP_S
                self.ser.timeout = self._timeout_s
            data: bytes = self.ser.read(length)
        except PORT_ERRORS as error:
            raise PortLost(str(error)) from None
        return data

    def setPacketTimeout(self, packet_length: int) -> None:
        """Set the deadline of a reply of `packet_length` bytes."""
        sent_ns = max(self._clock.now_ns(), self._sent_ns)
        self._deadline_ns = sent_ns + nanoseconds(self.reply_s(0, packet_length))

    def isPacketTimeout(self) -> bool:
        """Whether the deadline has passed."""
        return self._clock.now_ns() >= self._deadline_ns
