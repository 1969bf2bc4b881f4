"""Reopens a lost port of a sensor while the run continues.

Opening takes up to seconds, so it happens in a thread, and only in real time: ports in virtual time recover
by themselves. Meanwhile the sensor delivers no samples. A sensor that is silent for longer than its
`fail_after_s` is an error, in virtual time and in real time alike, so that a procedure ends in the same way
in both.
Only a program that watches a resting robot, such as `hil live`, waits longer.
"""

import logging
import threading
from collections.abc import Mapping
from typing import Any, Protocol, TypeVar, cast, runtime_checkable

from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError, HilError
from hil.core.interfaces import Sensor

LOG = logging.getLogger(__name__)

PATIENCE_S = 10.0
_PAUSE_S, _JOIN_S = 0.2, 15.0
S = TypeVar("S")


@runtime_checkable
class Reopenable(Protocol):
    """A driver that can reconnect to its device.

    Attributes:
        port_gone: True if the port itself has failed, so that waiting for the device is useless.
    """

    port_gone: bool

    def reopen(self) -> None:
        """Open again: sequence numbers continue, and a restart of the device's counters is marked."""


def reconnecting(
    sensors: Mapping[str, Sensor[Any]], clock: Clock, fail_after_s: Mapping[str, float] | None = None
) -> dict[str, Sensor[Any]]:
    """Wrap sensors that can reconnect in a `Reconnecting`; none in virtual time.

    Args:
        sensors: drivers by kind.
        clock: the bench clock.
        fail_after_s: silence that is an error, s, by kind; None to wait for every sensor.
    """
    real_time = clock.wall_offset() is not None
    waits = fail_after_s is None
    limits = fail_after_s or {}
    return {
        name: Reconnecting(sensor, clock, limits.get(name, PATIENCE_S), waits=waits)
        if real_time and isinstance(sensor, Reopenable) and not isinstance(sensor, Reconnecting)
        else sensor
        for name, sensor in sensors.items()
    }


class Reconnecting(Sensor[S]):
    """A sensor that may be disconnected for a while.

    Args:
        driver: driver of the sensor; a `Reopenable`.
        clock: the bench clock, in real time.
        patience_s: longest time without a connection, s.
        waits: True to wait also after an error of the driver; else that error is raised, and only a lost port
            is reopened.
    """

    def __init__(
        self, driver: Sensor[S], clock: Clock, patience_s: float = PATIENCE_S, *, waits: bool = True
    ) -> None:
        self.name, self._waits = driver.name, waits
        self._driver, self._clock, self._patience_ns = driver, clock, nanoseconds(patience_s)
        self._worker: threading.Thread | None = None
        self._ended = threading.Event()
        self._loss: HilError | None = None
        self._failure: HilError | None = None
        self._lost_ns = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._driver, name)

    def open(self) -> None:
        """Open the driver."""
        self._end()
        self._driver.open()

    def close(self) -> None:
        """End a running reopening and close the driver. Idempotent; never raises."""
        self._end()
        self._driver.close()

    def identity(self) -> Mapping[str, str]:
        """Identity of the device; empty while the sensor is disconnected."""
        return self._driver.identity() if self._worker is None else {}

    def read(self) -> tuple[S, ...]:
        """Samples since the last call; none while the sensor is disconnected.

        Raises:
            DeviceError: it has been disconnected for too long.
        """
        if self._worker is not None:
            if self._worker.is_alive():
                if not self._waits and self._away_ns > self._patience_ns:
                    raise self._given_up("it is still being opened", expected="", remedy="check its cable")
                return ()
            self._finish()
        try:
            samples = self._driver.read()
        except DeviceError as error:
            if not self._waits:
                raise
            self._begin(error)
            return ()
        if cast("Reopenable", self._driver).port_gone:
            self._begin(DeviceError(self.name, "its port has gone"))
        return samples

    def _begin(self, loss: HilError) -> None:
        self._loss, self._failure, self._lost_ns = loss, None, self._clock.now_ns()
        self._ended.clear()
        LOG.warning("%s; it is waited for up to %.0f s", loss, self._patience_ns / NS_PER_S)
        self._worker = threading.Thread(target=self._work, name=f"{self.name} again", daemon=True)
        self._worker.start()

    def _work(self) -> None:
        """Retry opening the device until it succeeds, takes too long, or the driver is closed."""
        driver = cast("Reopenable", self._driver)
        while not self._ended.is_set():
            try:
                driver.reopen()
                return
            except Exception as error:  # a library that lost its device may raise anything: retry
                if self._away_ns > self._patience_ns:
                    self._failure = error if isinstance(error, HilError) else HilError(repr(error))
                    return
            self._ended.wait(_PAUSE_S)

    def _finish(self) -> None:
        """Resume a reconnected device. Raises if it did not come back."""
        self._worker = None
        if self._failure is None:
            LOG.warning("%s is back after %.2f s", self.name, self._away_ns / NS_PER_S)
            return
        failure = self._failure
        raise self._given_up(failure.message, expected=failure.expected, remedy=failure.remedy)

    @property
    def _away_ns(self) -> int:
        return self._clock.now_ns() - self._lost_ns

    def _given_up(self, why: str, *, expected: str, remedy: str) -> DeviceTimeoutError:
        lost = "" if self._loss is None else getattr(self._loss, "message", str(self._loss))
        said = f"{lost}; it did not come back within {self._away_ns / NS_PER_S:.1f} s ({why})"
        return DeviceTimeoutError(self.name, said, expected=expected, remedy=remedy)

    def _end(self) -> None:
        self._ended.set()
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.join(_JOIN_S)
