"""A python-can bus for drivers: opened, drained a bounded number at a time, with errors that name a remedy.

In real time a thread receives the frames, as python-can needs 50 us for each, and converts them to samples,
which the loop takes from a queue. In virtual time (a clock without relation to the time of day) there is no
thread.
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, TypeVar

import can

from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError
from hil.links.can_arrival_times import ArrivalClock
from hil.support.emulated_can_mark import bitrate_of, bus_name, stays_on_host

_MULTICAST_ALL = ((socket.IPPROTO_IP, 49), (socket.IPPROTO_IPV6, 29))
"""`IP_MULTICAST_ALL` and `IPV6_MULTICAST_ALL` of Linux (/usr/include/linux/in.h, in6.h)."""


def of_own_group(interface: str, bus: can.BusABC) -> can.BusABC:
    """Restrict an open bus to frames of the multicast group that it has joined; returns the bus.

    python-can binds to the port alone, and Linux then delivers frames of every group that any program of the
    host has joined. Frames sent to the address of this host itself, not to a group, still arrive.

    Args:
        interface: of python-can; the bus of any other than `udp_multicast` is left as it is.
        bus: just opened; its `fileno` is that of its socket.
    """
    if interface == "udp_multicast":
        with socket.socket(fileno=os.dup(bus.fileno())) as same:
            for level, option in _MULTICAST_ALL:
                with contextlib.suppress(OSError):  # the option of the other version of IP, or another system
                    same.setsockopt(level, option, 0)
    return bus


_LOG = logging.getLogger(__name__)
_MOST_FRAMES = 512
_WAIT_S, _JOIN_S = 0.05, 0.5
_LOOK_NS, _CATCH_UP_NS, _HELD_UP_NS = 2_000_000, 100_000_000, 300_000_000
_ERROR_COUNTS = 16
_GONE_NS = 100_000_000
BUS_ERRORS = (can.CanError, OSError, ValueError, TypeError, AttributeError)

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


def has_failed(error: str, silent_ns: int) -> bool:
    """Whether an interface must be opened again: it reported an error, and no useful frame came for 0.1 s.

    Args:
        error: the last one that it reported, empty for none.
        silent_ns: time since the last useful frame.
    """
    return bool(error) and silent_ns > _GONE_NS


def open_bus(
    device: str, config: Any, expected: str = "a python-can interface and channel that exist"
) -> can.BusABC:
    """The bus of a table with `interface`, `channel`, `bitrate` and `options`.

    Raises:
        DeviceError: it cannot be opened, or is emulated with another bit rate; named after the device.
    """
    _check_bitrate(device, config)
    options: dict[str, Any] = dict(config.options)
    try:
        if stays_on_host(config.interface, config.channel, options):
            from hil.support.can_multicast import HostMulticastBus  # a daemon on SocketCAN needs none

            return HostMulticastBus(config.channel, **options)
        bus = can.Bus(interface=config.interface, channel=config.channel, bitrate=config.bitrate, **options)
        return of_own_group(config.interface, bus)
    except (*BUS_ERRORS, ImportError) as error:
        raise DeviceError(
            device,
            f"the CAN bus cannot be opened ({error})",
            port=f"{config.interface}:{config.channel}",
            expected=expected,
            remedy=f"check {device}.interface and {device}.channel; bring the interface up",
        ) from None


def _check_bitrate(device: str, config: Any) -> None:
    """Raise `DeviceError` for an emulated bus of another bit rate; a real one has only errors, or silence."""
    there = bitrate_of(bus_name(config.interface, config.channel, config.options))
    if there is not None and there != config.bitrate:
        raise DeviceError(
            device,
            f"the bus runs at {there} bit/s, {device}.bitrate is {config.bitrate}: no frame would arrive",
            port=f"{config.interface}:{config.channel}",
            expected="one bit rate on all of the bus",
            remedy=f"set {device}.bitrate = {there}",
        )


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


def receiver(bus: can.BusABC) -> Callable[[], can.Message | None]:
    """A function that returns the next frame that waits on a bus, or None, at once; the frame is read-only.

    An emulated bus in this process has frames of its own, which look like messages of python-can.
    """
    take: Callable[[], can.Message | None] = getattr(bus, "take", None) or partial(bus.recv, 0)
    return take


def shut(device: str, bus: can.BusABC | None) -> None:
    """Shut a bus down, if there is one; never raises."""
    if bus is not None:
        try:
            bus.shutdown()
        except BUS_ERRORS:
            _LOG.debug("%s: the bus did not shut down cleanly", device)


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

    Attributes:
        error: what the interface reported last; empty for nothing.
        error_frames: seen since `open`.
    """

    def __init__(self, device: str, config: Any, clock: Clock) -> None:
        self._device, self._config, self._clock = device, config, clock
        self._bus: can.BusABC | None = None
        self._reader: threading.Thread | None = None
        self._read: deque[Arrived] = deque(maxlen=_MOST_FRAMES)
        self._meaning: Meaning | None = None
        self._said: deque[Any] = deque(maxlen=_MOST_FRAMES)
        self._arrivals = ArrivalClock()
        self._asked_ns = clock.now_ns()
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
        self._read.clear()
        self._said.clear()
        self._meaning = None
        self._bus = bus = open_bus(self._device, self._config)
        if self._clock.wall_offset() is not None:
            name = f"{self._device} on CAN"
            self._reader = threading.Thread(target=self._read_on, args=(bus,), name=name, daemon=True)
            self._reader.start()

    def close(self) -> None:
        """Close the bus. Idempotent; never raises."""
        bus, self._bus = self._bus, None
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.join(_JOIN_S)
        shut(self._device, bus)

    def send(self, frame_id: int, data: bytes, *, extended: bool) -> None:
        """Send one frame; an error of the bus is kept in `error`."""
        if self._bus is None:
            return
        try:
            self._bus.send(can.Message(arbitration_id=frame_id, data=data, is_extended_id=extended))
        except BUS_ERRORS as error:
            self.error = str(error) or type(error).__name__

    def take(self, wait_s: float = 0.0) -> list[Arrived]:
        """Data frames that wait, with the time of their arrival, oldest first; a bounded number.

        Args:
            wait_s: longest wait for the first one.
        """
        if self._reader is None:
            return self._drain(self._bus, wait_s) if self._bus is not None else []
        read = self._read
        self._await(read, nanoseconds(wait_s))
        return [read.popleft() for _ in range(len(read))]

    def set_decoder(self, meaning: Meaning) -> None:
        """From now on `read_samples` gives the samples that `meaning` makes of frames; `take` gives nothing.

        Frames that wait are dropped: they are older than the next reader would assume.
        """
        for _ in range(_MOST_FRAMES):
            if not self.take():
                break
        self._meaning = meaning

    def read_samples(self) -> list[Any]:
        """Samples of the frames since the last call, oldest first, once `set_decoder` was called.

        After 0.3 s without a call it waits up to 0.1 s for a sample, so that the thread can catch up.
        """
        said = self._said
        if self._reader is None and self._bus is not None and self._meaning is not None:
            return self._meant(self._drain(self._bus, 0.0), self._meaning)
        asked_ns, self._asked_ns = self._asked_ns, self._clock.now_ns()
        if self._asked_ns - asked_ns > _HELD_UP_NS:
            self._await(said, _CATCH_UP_NS)
        return [said.popleft() for _ in range(len(said))] if said else []

    def _await(self, queue: deque[Any], wait_ns: int) -> None:
        """Wait until the thread has put something into the queue, for `wait_ns` at most."""
        end_ns = self._clock.now_ns() + wait_ns
        while not queue and self._clock.now_ns() < end_ns:
            self._clock.sleep_until_ns(self._clock.now_ns() + _LOOK_NS)

    def _meant(self, arrived: list[Arrived], meaning: Meaning) -> list[Any]:
        """The samples of frames, without those that give none."""
        now_ns = self._clock.now_ns()
        said = [meaning(t_ns, message, now_ns) for t_ns, message in arrived]
        return [one for one in said if one is not None]

    def _read_on(self, bus: can.BusABC) -> None:
        """Take frames from the bus until it is closed: in a thread, so that the loop does not pay for it."""
        while self._bus is bus:
            arrived = self._drain(bus, _WAIT_S)
            if (meaning := self._meaning) is None:
                self._read.extend(arrived)
            else:
                self._said.extend(self._meant(arrived, meaning))

    def _drain(self, bus: can.BusABC, wait_s: float) -> list[Arrived]:
        """Frames that wait on the bus; a bounded number."""
        found: list[Arrived] = []
        budget, take = _MOST_FRAMES, receiver(bus)
        while budget > 0:
            try:
                message = bus.recv(wait_s) if wait_s else take()
            except BUS_ERRORS as error:
                self.error = str(error) or type(error).__name__
                budget -= _ERROR_COUNTS
                if wait_s:
                    self._clock.sleep_until_ns(self._clock.now_ns() + nanoseconds(wait_s))
                    break
                continue
            wait_s = 0.0
            if message is None:
                break
            budget -= 1
            if message.is_error_frame:
                self.error_frames += 1
            elif not message.is_remote_frame:
                arrival_ns = self._arrivals.arrival_ns(message.timestamp, self._clock.now_ns())
                found.append((arrival_ns, message))
        return found

    def bus_errors(self) -> str:
        """Errors of the interface so far, to be appended to a message; empty for none."""
        seen = f", {self.error_frames} error frames" * bool(self.error_frames)
        return seen + f", {self.error}" * bool(self.error)
