"""Ports, buses and streams of real devices with faults in front of them.

The bench opens a driver within `in_front_of`. What the driver then opens has the faults of its device. Only
what comes from the device passes through them; without a plan nothing is wrapped.
"""

import contextlib
import select
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Generic, TypeVar

import serial

from hil.core.clock import NS_PER_S, nanoseconds
from hil.faults.at_the_link import LinkFaults
from hil.links.framing import FRAMINGS, messages

T = TypeVar("T")
_FAULTS: ContextVar[LinkFaults | None] = ContextVar("faults of the device", default=None)
_POLL_S = 0.0001


@contextmanager
def in_front_of(faults: LinkFaults) -> Iterator[None]:
    """Put faults in front of whatever is opened within the context."""
    token = _FAULTS.set(faults)
    try:
        yield
    finally:
        _FAULTS.reset(token)


def present() -> LinkFaults | None:
    """Faults of the device that is being opened; None for none."""
    return _FAULTS.get()


def with_faults(
    opened: Any, wrapped: Callable[[Any, LinkFaults], Any], faults: LinkFaults | None = None
) -> Any:
    """Return what was opened, wrapped if its device has faults.

    Args:
        opened: port, bus or stream.
        wrapped: function that wraps it.
        faults: faults of the device; `present` ones by default.
    """
    found = present() if faults is None else faults
    return opened if found is None else wrapped(opened, found)


class HeldBack(Generic[T]):
    """Queue of what arrives later than it came; when all faults are ended, what is in it is discarded.

    Args:
        faults: faults of the device.
    """

    def __init__(self, faults: LinkFaults) -> None:
        self._faults, self._queue, self._ended = faults, deque[tuple[int, T]](), False

    def __bool__(self) -> bool:
        self._discard()
        return bool(self._queue)

    @property
    def next_ns(self) -> int | None:
        """Time at which the next is due; None for none."""
        self._discard()
        return self._queue[0][0] if self._queue else None

    def add(self, due_ns: int, item: T) -> None:
        """Add what is due at a time, or behind those before it."""
        self._queue.append((max(due_ns, self._queue[-1][0]) if self._queue else due_ns, item))

    def take(self, now_ns: int) -> T | None:
        """Take the oldest that is due, or None."""
        self._discard()
        return self._queue.popleft()[1] if self._queue and self._queue[0][0] <= now_ns else None

    def _discard(self) -> None:
        if self._faults.over and not self._ended:
            self._queue.clear()
            self._ended = True


class FaultyPort:
    """A serial port with faults in front of it; everything but reading is the port's own.

    Args:
        port: open port of pyserial.
        faults: faults of the device.
    """

    def __init__(self, port: Any, faults: LinkFaults) -> None:
        own = self.__dict__
        own["_port"], own["_faults"], own["_framing"] = port, faults, FRAMINGS.get(faults.framing)
        own["_waiting"] = faults.waiting
        own["_raw"], own["_ready"] = bytearray(), bytearray()
        own["_later"], own["_rest"], own["_kept"] = HeldBack[bytes](faults), 0, True

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.__dict__:
            self.__dict__[name] = value
        else:
            setattr(self._port, name, value)

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read at once."""
        if self._waiting():
            return int(self._port.in_waiting)
        self._must_be_there()
        if self._passes():
            return int(self._port.in_waiting)
        self._pull()
        return len(self._ready)

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes; waits for what is missing as long as the port's timeout allows."""
        if self._waiting():
            return self._port.read(size)  # type: ignore[no-any-return]
        self._must_be_there()
        if self._passes():
            return bytes(self._port.read(size))
        timeout_s = self._port.timeout
        end_ns = None if timeout_s is None else self._faults.clock.now_ns() + nanoseconds(timeout_s)
        while True:
            if len(self._ready) < size:
                self._pull()
            now_ns = self._faults.clock.now_ns()
            if len(self._ready) >= size or (end_ns is not None and now_ns >= end_ns):
                data = bytes(self._ready[:size])
                del self._ready[:size]
                return data
            self._wait(now_ns, end_ns)
            self._must_be_there()

    def write(self, data: bytes) -> int:
        """Send; nothing is altered."""
        if not self._waiting():
            self._must_be_there()
        return int(self._port.write(data))

    def reset_input_buffer(self) -> None:
        """Discard what has arrived; what is late still arrives."""
        self._port.reset_input_buffer()
        self._raw.clear()
        self._ready.clear()

    def _must_be_there(self) -> None:
        if self._faults.gone():
            self.reset_input_buffer()  # what was sent to an adapter that was away is lost
            raise serial.SerialException(f"the adapter of {self._faults.name} is gone (injected fault)")

    def _passes(self) -> bool:
        """Whether no fault acts and nothing waits here, so that the port itself can be read."""
        return not (self._later or self._raw or self._ready) and not self._faults.acting()

    def _pull(self) -> None:
        """Take what has arrived at the port through the faults."""
        count = self._port.in_waiting
        if count:
            self._raw.extend(self._port.read(count))
        now_ns = self._faults.clock.now_ns()
        self._pass_rest(now_ns)
        for message in messages(self._framing, self._raw):
            for late_ns, piece in self._faults.arriving(message):
                self._later.add(now_ns + late_ns, piece)
        if self._begin_early():
            self._pass_rest(now_ns)
        if self._raw and not self._faults.acting():
            self._later.add(now_ns, bytes(self._raw))
            self._raw.clear()
        while (piece := self._later.take(now_ns)) is not None:
            self._ready.extend(piece)

    def _begin_early(self) -> bool:
        """Decide the fate of a message from its head, where it can only be lost; its bytes do not wait."""
        if self._framing is None or len(self._raw) < self._framing.head or not self._faults.only_lose():
            return False
        length = self._framing.length(self._raw)
        if length <= len(self._raw):
            return False
        self._rest, self._kept = length, self._faults.arrives()
        return True

    def _pass_rest(self, now_ns: int) -> None:
        """Pass on, or drop, bytes of a message whose fate is decided."""
        if not self._rest:
            return
        part = bytes(self._raw[: self._rest])
        del self._raw[: self._rest]
        self._rest -= len(part)
        if self._kept:
            self._later.add(now_ns, part)

    def _wait(self, now_ns: int, end_ns: int | None) -> None:
        """Wait for more bytes, at most until the next late ones are ready."""
        ends = [t for t in (end_ns, self._later.next_ns) if t is not None]
        wait_s = max(0.0, (min(ends) - now_ns) / NS_PER_S) if ends else _POLL_S
        with contextlib.suppress(Exception):
            select.select([self._port.fileno()], [], [], min(wait_s, 100 * _POLL_S))
            return
        self._faults.clock.sleep_until_ns(now_ns + nanoseconds(min(wait_s, _POLL_S)))


class FaultyBus:
    """An open CAN bus with faults in front of it; sending is the bus's own.

    Args:
        bus: open bus (`hil.links.can_interface.OpenBus`).
        faults: faults of the device.
        own: function from a frame to True if the device sends it; the frames of others pass at once.
    """

    def __init__(
        self, bus: Any, faults: LinkFaults, own: Callable[[Any], bool] = lambda message: True
    ) -> None:
        self._bus, self._faults, self._own = bus, faults, own
        self._later = HeldBack[Any](faults)
        self.send, self.shut = bus.send, bus.shut

    def receive(self, wait_s: float = 0.0) -> Any:
        """The next frame, or None after `wait_s`."""
        if not self._later and not self._faults.acting():
            return self._bus.receive(wait_s)
        end_ns = self._faults.clock.now_ns() + nanoseconds(wait_s)
        while True:
            now_ns = self._faults.clock.now_ns()
            if (due := self._later.take(now_ns)) is not None:
                return due
            left_s = max(0.0, (end_ns - now_ns) / NS_PER_S)
            message = self._bus.receive(min(left_s, _POLL_S) if self._later else left_s)
            if message is not None:
                if not self._own(message):
                    return message
                self._queue(message)
            elif now_ns >= end_ns:
                return None

    def _queue(self, message: Any) -> None:
        now_ns = self._faults.clock.now_ns()
        for late_ns, data in self._faults.arriving(bytes(message.data)):
            frame = message
            if late_ns or data != bytes(message.data):
                frame = _altered(message, data, late_ns)
            self._later.add(now_ns + late_ns, frame)


def _altered(message: Any, data: bytes, late_ns: int) -> Any:
    """A frame with other data that has arrived later."""
    from can import Message  # a bench without CAN needs none

    return Message(
        timestamp=message.timestamp + late_ns / NS_PER_S,
        arbitration_id=message.arbitration_id,
        is_extended_id=message.is_extended_id,
        data=data,
    )


class FaultyDatagrams:
    """A UDP port with faults in front of it; sending is the port's own.

    Args:
        port: open port (`DatagramPort`).
        faults: faults of the device.
    """

    def __init__(self, port: Any, faults: LinkFaults) -> None:
        self._port, self._faults = port, faults
        self._later = HeldBack[Any](faults)
        self.send, self.close = port.send, port.close

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    def receive(self) -> Any:
        """The oldest datagram that has arrived, or None; never waits."""
        if not self._later and not self._faults.acting():
            return self._port.receive()
        while (found := self._port.receive()) is not None:
            now_ns = self._faults.clock.now_ns()
            for late_ns, data in self._faults.arriving(found.data):
                arrived = found._replace(data=data, arrived_ns=found.arrived_ns + late_ns)
                self._later.add(now_ns + late_ns, arrived)
        return self._later.take(self._faults.clock.now_ns())


def faulty_callback(take: Callable[[T], None], faults: LinkFaults) -> Callable[[T], None]:
    """Make a callback that a library calls with every frame; frames are lost or come twice."""

    def called(frame: T) -> None:
        for _ in faults.arriving(b"\0") if faults.acting() else ((0, b""),):
            take(frame)

    return called
