"""A python-can bus as a driver needs it: opened, drained within bounds, with errors that say what to do."""

from __future__ import annotations

import logging
from typing import Any

import can

from hil.drivers.encoders.timeline import ArrivalClock
from hil.vocabulary.clock import Clock, nanoseconds
from hil.vocabulary.errors import DeviceError

_LOG = logging.getLogger(__name__)
_MOST_FRAMES = 512
_ERROR_COUNTS = 16
BUS_ERRORS = (can.CanError, OSError, ValueError, TypeError, AttributeError)

Arrived = tuple[int, can.Message]


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
        self._arrivals = ArrivalClock()
        self.error, self.error_frames = "", 0

    @property
    def port(self) -> str:
        """Interface and channel."""
        return f"{self._config.interface}:{self._config.channel}"

    @property
    def is_open(self) -> bool:
        """Whether it has a bus."""
        return self._bus is not None

    def open(self) -> None:
        """Open the bus; raises `DeviceError`."""
        self.close()
        config = self._config
        options: dict[str, Any] = dict(config.options)
        self._arrivals = ArrivalClock()
        self.error, self.error_frames = "", 0
        try:
            self._bus = can.Bus(
                interface=config.interface, channel=config.channel, bitrate=config.bitrate, **options
            )
        except (*BUS_ERRORS, ImportError) as error:
            raise DeviceError(
                self._device,
                f"the CAN bus cannot be opened ({error})",
                port=self.port,
                expected="a python-can interface and channel that exist",
                remedy=f"check {self._device}.interface and {self._device}.channel; bring the interface up",
            ) from None

    def close(self) -> None:
        """Let go of the bus. Idempotent; never raises."""
        bus, self._bus = self._bus, None
        if bus is not None:
            try:
                bus.shutdown()
            except BUS_ERRORS:
                _LOG.debug("%s: the bus did not shut down cleanly", self._device)

    def send(self, frame_id: int, data: bytes, *, extended: bool) -> None:
        """Send one frame; what the bus says against it is kept in `error`."""
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
        found: list[Arrived] = []
        budget = _MOST_FRAMES
        while self._bus is not None and budget > 0:
            try:
                message = self._bus.recv(wait_s)
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

    def let_go(self) -> None:
        """Drop what waits: it is older than whoever reads next would think."""
        for _ in range(_MOST_FRAMES):
            if not self.take():
                return

    def told(self) -> str:
        """What the interface has said, to be appended to a complaint; empty for nothing."""
        seen = f", {self.error_frames} error frames" * bool(self.error_frames)
        return seen + f", {self.error}" * bool(self.error)
