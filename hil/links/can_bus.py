"""A python-can bus for drivers: drained a bounded number of frames at a time, opened again when it fails.

In real time a thread receives the frames, as python-can needs 50 us for each and some interfaces stamp a
frame only when it is read. It converts them to samples, which the loop takes from a queue, and opens a failed
bus again. In virtual time (a clock without relation to the time of day) there is no thread, and an emulated
bus recovers by itself.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, TypeVar

import can

from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError
from hil.faults.at_the_link import LinkFaults
from hil.links.can_arrival_times import ArrivalClock
from hil.links.can_interface import BusFailedError, OpenBus, open_bus
from hil.links.injection import FaultyBus, present, with_faults

_MOST_FRAMES = 512
_WAIT_S, _JOIN_S = 0.05, 0.5
_LOOK_NS, _CATCH_UP_NS = 2_000_000, 100_000_000
_BEHIND_NS, _HELD_UP_NS = 50_000_000, 300_000_000
_ERROR_COUNTS = 16
_GONE_NS, _AGAIN_S = 100_000_000, 0.5

STANDARD_IDS = 0x800
"""Number of identifiers of 11 bits."""
_EXTENDED = 1 << 31

Arrived = tuple[int, can.Message]
Meaning = Callable[[int, can.Message, int], Any]
"""Converts (arrival, frame, time now) to a sample, times in ns; None for a frame that gives none. In real
time only the reading thread calls it."""
T = TypeVar("T")


def frame_key(identifier: int, extended: bool) -> int:
    """Number for an identifier and its width: the identifier, plus 2**31 if 11 bits hold it but it has 29."""
    return identifier | _EXTENDED if extended and identifier < STANDARD_IDS else identifier


def shown_key(key: int) -> str:
    """A frame's key, as in `0x1A0` or `0x1A0 (29 bits)`."""
    return f"0x{key & _EXTENDED - 1:X}" + " (29 bits)" * (key >= STANDARD_IDS)


def remedy_of_silence(device: str, config: Any, node: str) -> str:
    """Remedy text for a silent bus: first the causes that silence all of it.

    Args:
        device: name in the bench file.
        config: its table.
        node: the node that should send, as in `check the supply of {node}`.
    """
    shown = f", `ip -details link show {config.channel}`" * (config.interface == "socketcan")
    return (
        f"check first that all on the bus have the same bit rate ({device}.bitrate = {config.bitrate}"
        f"{shown}), then CAN wiring, adapter and termination, and the supply of {node}"
    )


def detected(table: Callable[..., T], **values: Any) -> Iterator[T]:
    """A table for each CAN bus that the system has, with further `values`."""
    for found in can.detect_available_configs(["socketcan"]):
        yield table(interface=str(found["interface"]), channel=str(found["channel"]), **values)


class CanLink:
    """One bus.

    Args:
        device: name in errors.
        config: table with `interface`, `channel`, `bitrate` and `options`.
        clock: the bench clock.
        own: function from the identifier of a frame (`frame_key`) to True if the device sends it: only those
            have the faults that are injected in front of the device. By default all have.

    Attributes:
        error: latest error of the interface; empty for nothing.
        error_frames: number of error frames since `open`.
    """

    def __init__(
        self, device: str, config: Any, clock: Clock, own: Callable[[int], bool] = lambda key: True
    ) -> None:
        self._device, self._config, self._clock, self._own = device, config, clock, own
        self._bus: OpenBus | None = None
        self._reader: threading.Thread | None = None
        self._lock = threading.Lock()
        self._read: deque[Arrived] = deque(maxlen=_MOST_FRAMES)
        self._meaning: Meaning | None = None
        self._broken: Exception | None = None
        self._said: deque[Any] = deque(maxlen=_MOST_FRAMES)
        self._arrivals = ArrivalClock()
        self._asked_ns = self._emptied_ns = 0
        self._failing_ns: int | None = None
        self._faults: LinkFaults | None = None
        self.error, self.error_frames = "", 0

    @property
    def port(self) -> str:
        """Interface and channel."""
        return f"{self._config.interface}:{self._config.channel}"

    def open(self) -> None:
        """Open the bus; raises `DeviceError`."""
        self.close()
        self._arrivals = ArrivalClock()
        self.error, self.error_frames = "", 0
        self._failing_ns, self._asked_ns = None, self._clock.now_ns()
        self._read.clear()
        self._said.clear()
        self._meaning = self._broken = None
        self._faults = present()
        self._bus = self._opened()
        if self._clock.wall_offset() is not None:
            name = f"{self._device} on CAN"
            self._reader = threading.Thread(target=self._read_on, name=name, daemon=True)
            self._reader.start()

    def _opened(self) -> OpenBus:
        opened = OpenBus(open_bus(self._device, self._config))
        bus: OpenBus = with_faults(opened, partial(FaultyBus, own=self._is_own), self._faults)
        return bus

    def _is_own(self, message: can.Message) -> bool:
        return self._own(frame_key(message.arbitration_id, message.is_extended_id))

    def close(self) -> None:
        """Close the bus. Idempotent; never raises."""
        with self._lock:
            reader, self._reader = self._reader, None
            bus, self._bus = self._bus, None
        if reader is not None:
            reader.join(_JOIN_S)
        if bus is not None:
            bus.shut()

    def send(self, frame_id: int, data: bytes, *, extended: bool) -> None:
        """Send one frame; an error of the bus is kept in `error`."""
        if (bus := self._bus) is None:
            return
        try:
            bus.send(frame_id, data, extended=extended)
        except BusFailedError as error:
            self.error = str(error)

    def take(self, wait_s: float = 0.0) -> list[Arrived]:
        """Data frames that wait, with the time of their arrival, oldest first; a bounded number.

        Args:
            wait_s: longest wait for the first one.
        """
        if self._reader is None:
            return self._drain(self._bus, wait_s) if self._bus is not None else []
        return self._waiting(self._read, nanoseconds(wait_s))

    def set_decoder(self, meaning: Meaning) -> None:
        """Make `read_samples` give the samples that `meaning` makes of frames; `take` then gives nothing.

        Frames that wait are dropped: they are older than the next reader would assume.
        """
        for _ in range(_MOST_FRAMES):
            if not self.take():
                break
        self._meaning = meaning

    def read_samples(self) -> list[Any]:
        """Samples of the frames since the last call, oldest first, once `set_decoder` was called.

        What the decoder has raised in the reading thread is raised here.
        """
        broken, self._broken = self._broken, None
        if broken is not None:
            raise broken
        if self._reader is None and self._bus is not None and self._meaning is not None:
            return self._meant(self._drain(self._bus, 0.0), self._meaning)
        return self._waiting(self._said, 0)

    def _waiting(self, queue: deque[T], wait_ns: int) -> list[T]:
        """What the thread has put into a queue; waits for a first one, for `wait_ns` at most.

        After 0.3 s without a call that is at least 0.1 s, so that the thread can catch up.
        """
        asked_ns, self._asked_ns = self._asked_ns, self._clock.now_ns()
        if self._asked_ns - asked_ns > _HELD_UP_NS:
            wait_ns = max(wait_ns, _CATCH_UP_NS)
        end_ns = self._asked_ns + wait_ns
        self._catch_up(asked_ns)
        while not queue and (now_ns := self._clock.now_ns()) < end_ns:
            self._clock.sleep_until_ns(now_ns + _LOOK_NS)
            self._catch_up(now_ns)
        return [queue.popleft() for _ in range(len(queue))] if queue else []

    def _catch_up(self, since_ns: int) -> None:
        """If this thread has not looked for 50 ms, wait for what has arrived until now.

        The reading thread may be behind: what stops this program, or holds the interpreter, stops it, too.
        """
        now_ns = self._clock.now_ns()
        if now_ns - since_ns > _BEHIND_NS and self._bus is not None:
            while self._emptied_ns < now_ns and self._clock.now_ns() < now_ns + _CATCH_UP_NS:
                self._clock.sleep_until_ns(self._clock.now_ns() + _LOOK_NS)

    def _meant(self, arrived: list[Arrived], meaning: Meaning) -> list[Any]:
        """The samples of frames, without those that give none."""
        now_ns = self._clock.now_ns()
        said = [meaning(t_ns, message, now_ns) for t_ns, message in arrived]
        return [one for one in said if one is not None]

    def _read_on(self) -> None:
        """Take frames from the bus until it is closed: in a thread, so that the loop does not pay for it."""
        own = threading.current_thread()
        while self._reader is own:
            if (bus := self._bus) is None:
                self._open_again(own)
                continue
            arrived = self._drain(bus, _WAIT_S)
            if (meaning := self._meaning) is None:
                self._read.extend(arrived)
            else:
                try:
                    self._said.extend(self._meant(arrived, meaning))
                except Exception as error:  # the thread goes on: a silent device would hide the cause
                    self._broken = error
            self._emptied_ns = self._clock.now_ns()
            if self._failing_ns is not None and self._clock.now_ns() - self._failing_ns > _GONE_NS:
                with self._lock:
                    self._bus = None if self._bus is bus else self._bus
                bus.shut()

    def _open_again(self, own: threading.Thread) -> None:
        """Open a failed bus again, or wait half a second; a link that was closed meanwhile stays closed."""
        try:
            bus = self._opened()
        except DeviceError as error:
            self.error = error.message
            self._clock.sleep_until_ns(self._clock.now_ns() + nanoseconds(_AGAIN_S))
            return
        with self._lock:
            if self._reader is own:
                self._arrivals, self._failing_ns, self._bus = ArrivalClock(), None, bus
                return
        bus.shut()

    def _drain(self, bus: OpenBus, wait_s: float) -> list[Arrived]:
        """Frames that wait on the bus; a bounded number."""
        found: list[Arrived] = []
        budget, first_s = _MOST_FRAMES, wait_s
        while budget > 0:
            wait_s, now_s = 0.0, wait_s
            try:
                message = bus.receive(now_s)
            except BusFailedError as error:
                self.error = str(error)
                self._failing_ns = self._failing_ns or self._clock.now_ns()
                budget -= _ERROR_COUNTS
                continue
            self._failing_ns = None
            if message is None:
                break
            budget -= 1
            if message.is_error_frame:
                self.error_frames += 1
            elif not message.is_remote_frame:
                arrival_ns = self._arrivals.arrival_ns(message.timestamp, self._clock.now_ns())
                found.append((arrival_ns, message))
        if self._failing_ns is not None and first_s:
            self._clock.sleep_until_ns(self._clock.now_ns() + nanoseconds(first_s))
        return found

    def bus_errors(self) -> str:
        """Errors of the interface so far, to be appended to a message; empty for none."""
        seen = f", {self.error_frames} error frames" * bool(self.error_frames)
        return seen + f", {self.error}" * bool(self.error)
