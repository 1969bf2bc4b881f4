"""The seam between a bench and its fan, and the keeper that lives in the bench itself, in virtual time."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Callable
from typing import Protocol

from hil.drivers.adhesion.keeper.beat import Beat, open_bus
from hil.drivers.adhesion.keeper.client import Status
from hil.drivers.adhesion.keeper.core import Keeper, SetPoint
from hil.drivers.adhesion.keeper.spec import Spec
from hil.vocabulary.clock import Clock, nanoseconds

_LOG = logging.getLogger(__name__)


class Kept(Protocol):
    """A fan that goes on running whatever happens to the bench."""

    @abstractmethod
    def open(self) -> None:
        """Find or start who keeps it; a fan that runs goes on as it runs. Raises `DeviceError`."""

    @abstractmethod
    def set(self, point: SetPoint) -> None:
        """Another set-point; it is reached along a ramp. Raises `UsageError`, `DeviceError`."""

    @abstractmethod
    def end(self, confirmed_by: str) -> None:
        """Let the fan come to rest along the ramp; `confirmed_by` says why nothing can fall."""

    @abstractmethod
    def status(self) -> Status:
        """As the keeper's socket tells it: at least `state`, `sent`, `target`, `bus_error`."""

    @abstractmethod
    def trouble(self) -> str:
        """What is wrong with how the fan is kept; empty for nothing."""

    @abstractmethod
    def close(self) -> None:
        """Leave it to the keeper. The fan goes on. Idempotent; never raises."""


class KeptHere(Kept):
    """A keeper on the bench's own clock and bus: where no other process could reach the fan.

    Args:
        spec: the fan.
        clock: the bench clock.
    """

    def __init__(self, spec: Spec, clock: Clock) -> None:
        self._spec, self._clock = spec, clock
        self._end: Callable[[], None] | None = None
        self._keeper = Keeper(spec)
        self._beat = Beat(spec, self._keeper, _LOG.info)

    def open(self) -> None:
        """Begin to keep it."""
        self.close()
        self._beat = Beat(self._spec, self._keeper, _LOG.info, open_bus(self._spec))
        self._end = self._clock.schedule(self._task, self._clock.now_ns())

    def _task(self, t_ns: int) -> int:
        self._beat.beat(t_ns)
        return t_ns + nanoseconds(self._spec.period_s)

    def set(self, point: SetPoint) -> None:
        """As of a keeper."""
        self._keeper.wish(self._clock.now_ns(), point)

    def end(self, confirmed_by: str) -> None:
        """As of a keeper."""
        _LOG.info("off, confirmed: %s", confirmed_by)
        self._keeper.end(self._clock.now_ns())

    def status(self) -> Status:
        """As of a keeper."""
        return self._beat.status(self._clock.now_ns())

    def trouble(self) -> str:
        """What is wrong with the bus."""
        return self._beat.bus_error

    def close(self) -> None:
        """Nobody commands the fan from here on."""
        if self._end is not None:
            self._end()
            self._end = None
            self._beat.close()
