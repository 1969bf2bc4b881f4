"""pyserial scheme `hil://NAME`: a port on an emulated serial line, on the virtual clock.

pyserial finds the scheme by this module's name in a package listed in
`serial.protocol_handler_packages`. Waiting advances world time. A query of an empty port takes a little world
time, so that a client that polls it makes progress.
"""

import errno
from typing import Any
from urllib.parse import urlsplit

from serial import SerialBase, SerialException

from hil.core.clock import nanoseconds
from hil.fakes.serial_line import SerialLine, Unplugged, find_line, line_names
from hil.fakes.world import NEVER_NS

_LOOK_NS = 50_000
"""World time that a query of an empty port takes."""


class Serial(SerialBase):
    """A pyserial port connected to an emulated chip."""

    _line: SerialLine | None = None
    _timeout: float | None
    _baudrate: int
    _break_state = _rts_state = _dtr_state = False

    def open(self) -> None:
        """Open the line; raises `SerialException` if it does not exist or is in use."""
        name = urlsplit(str(self.portstr)).netloc
        try:
            line = find_line(name)
        except KeyError:
            known = ", ".join(line_names()) or "none"
            raise SerialException(errno.ENOENT, f"no emulated line {name!r}; open ones: {known}") from None
        if line.in_use:
            raise SerialException(errno.EBUSY, f"hil://{name} is in use")
        line.in_use = True
        line.discard()  # as a kernel does with bytes for a closed port
        line.listen(lambda: int(self._baudrate))
        self._line = line
        self.is_open = True
        self._reconfigure_port()

    def close(self) -> None:
        """Release the line. Idempotent."""
        if self._line is not None:
            self._line.in_use = False
            self._line.listen(None)
            self._line = None
        self.is_open = False

    def _reconfigure_port(self, *args: Any, **kwargs: Any) -> None:
        """Apply changed settings of the port."""
        self._wait_ns = NEVER_NS if self._timeout is None else max(nanoseconds(self._timeout), _LOOK_NS)

    def _opened(self) -> SerialLine:
        if self._line is None:
            raise SerialException(errno.EBADF, "the port is not open")
        if not self._line.faults.empty:
            try:
                self._line.check_plugged()
            except Unplugged as gone:
                raise SerialException(errno.EIO, str(gone)) from None
        return self._line

    @property
    def in_waiting(self) -> int:
        """Number of bytes that a read would return at once; a query of an empty port takes world time."""
        line = self._opened()
        count = line.waiting()
        if not count:
            line.world.advance_to(line.world.now_ns + _LOOK_NS)
            count = line.waiting()
        return count

    def read(self, size: int = 1, /) -> bytes:
        """Wait for `size` bytes, at most `timeout`; raises `SerialException` if the adapter is unplugged."""
        line = self._line
        if line is None or not line.faults.empty:
            line = self._opened()
        world = line.world
        out = line.take(size)
        if len(out) >= size:
            return out
        deadline_ns = world.now_ns + self._wait_ns
        while len(out) < size and world.now_ns < deadline_ns:
            step_ns = line.next_event_ns(size - len(out))
            if step_ns > deadline_ns:
                step_ns = deadline_ns
            if step_ns >= NEVER_NS:
                step_ns = world.next_due_ns()
            if step_ns >= NEVER_NS:
                raise SerialException("nothing will ever arrive on this line")
            world.advance_to(step_ns)
            out += line.take(size - len(out))
        if not line.faults.empty:
            self._opened()
        return out

    def write(self, data: Any, /) -> int:
        """Pass bytes to the adapter; returns at once."""
        payload = data if isinstance(data, bytes) else bytes(data)
        if payload:
            self._opened().send(payload, self._baudrate)
        return len(payload)

    def flush(self) -> None:
        """Wait until all bytes have been sent."""
        line = self._opened()
        line.world.advance_to(line.sent_ns())

    def cancel_read(self) -> None:
        """Do nothing: no call blocks, because waiting advances the world."""

    def cancel_write(self) -> None:
        """Do nothing: all written bytes are already on the wire."""

    def reset_input_buffer(self) -> None:
        """Discard the received bytes."""
        self._opened().discard()

    def reset_output_buffer(self) -> None:
        """Do nothing: all written bytes are already on the wire."""

    def _update_break_state(self) -> None:
        return None

    def _update_rts_state(self) -> None:
        return None

    def _update_dtr_state(self) -> None:
        return None

    @property
    def cts(self) -> bool:
        """The line has no modem signals; clear to send."""
        return True

    @property
    def dsr(self) -> bool:
        """The line has no modem signals."""
        return True

    @property
    def ri(self) -> bool:
        """The line has no modem signals."""
        return False

    @property
    def cd(self) -> bool:
        """The line has no modem signals."""
        return True
