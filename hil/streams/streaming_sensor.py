"""Base of streaming sensors: rising stamps, stuck values, and the time after which silence is an error."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

from hil.config.device import DeviceConfig
from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.core.errors import DeviceTimeoutError
from hil.core.interfaces import Sensor
from hil.core.signals import Stamp
from hil.streams.silence_limit import SilenceTimer, used_while_closed
from hil.streams.stuck_values import StuckTest

C = TypeVar("C", bound=DeviceConfig)
S = TypeVar("S", covariant=True)

_STUCK_S, _FEWEST = 0.2, 8
"""Periods that a silence lasts at least before it is an error."""


class StreamingSensor(Sensor[S], Generic[C, S]):
    """Base of `SerialSensor` and `CanSensor`.

    Args:
        config: a `hil.config.streaming_sensors.StreamConfig`, or a table with `rate_hz`, `fail_after_s` and
            `open_timeout_s`.
        clock: the bench clock; every wait and every stamp is on it.

    Attributes:
        name: kind of the device.
        what: name of one measurement, in errors.
        expected: expected device, in errors.
        remedy: remedy for silence.
        port_gone: True if port or bus have failed; the bench opens the sensor again (`reopen`).
        period_ns: period between two samples.
        heard_ns: time at which the last whole measurement came.
        stuck: detector of measurements that are the same to the last bit for too long.
    """

    name: str
    what = "measurement"
    expected = "the device"
    remedy = "check power and cable"

    def __init__(self, config: C, clock: Clock) -> None:
        table: Any = config
        self.config, self.clock = table, clock
        self.port_gone = False
        self.period_ns = nanoseconds(1.0 / table.rate_hz)
        self.stuck = StuckTest(getattr(config, "stuck_after_s", _STUCK_S))
        self._latency_ns = nanoseconds(getattr(config, "latency_s", 0.0))
        fail_ns = max(nanoseconds(table.fail_after_s), _FEWEST * self.period_ns)
        self._silence = SilenceTimer(fail_ns / NS_PER_S)
        self._identity: dict[str, str] = {}
        self._sequence = self._t_ns = 0
        self.heard_ns = 0

    @property
    @abstractmethod
    def place(self) -> str:
        """Port or bus, in errors."""

    @abstractmethod
    def _connect(self) -> Mapping[str, str]:
        """Open, identify, set up; the identity. Raises `DeviceError`."""

    @abstractmethod
    def _disconnect(self) -> None:
        """Close port or bus; never raises."""

    @abstractmethod
    def _take(self, now_ns: int) -> list[tuple[Any, int]]:
        """Measurements since the last call (None: damaged), with their arrival (ns)."""

    @abstractmethod
    def sample(self, item: Any, stamp: Stamp) -> S:
        """A measurement, or None for a damaged one, as a sample."""

    def open(self) -> None:
        """Open, identify, set up; raises `DeviceError`."""
        self.close()
        self._sequence = 0
        self.reopen()

    def reopen(self) -> None:
        """Open again after an outage of port or bus: sample numbers go on. Raises `DeviceError`."""
        self._disconnect()
        try:
            identity = self._connect()
        except BaseException:
            self.close()
            raise
        self._identity = {**identity, "port": self.place}
        self.port_gone = False
        self.heard_ns = self.clock.now_ns()
        self._silence.begin(self.heard_ns)
        self.stuck.reset(self.heard_ns)

    def close(self) -> None:
        """Close port or bus; the sensor goes on by itself. Idempotent."""
        self._identity = {}
        self._disconnect()

    def identity(self) -> Mapping[str, str]:
        """What was found, and the port; empty while closed."""
        return self._identity

    def read(self) -> tuple[S, ...]:
        """All samples since the last call.

        Raises:
            DeviceTimeoutError: no whole measurement for `fail_after_s`.
        """
        if not self._identity:
            raise used_while_closed(self.name, self.place)
        now_ns = self.clock.now_ns()
        items = self._take(now_ns)
        whole = any(item is not None for item, _ in items)
        if whole:
            self.heard_ns = now_ns
        if overdue_ns := self._silence.overdue_ns(whole, now_ns):
            gone = "; its port has gone" if self.port_gone else ""
            raise self.silent(f"no {self.what} for {overdue_ns / NS_PER_S:.1f} s{gone}")
        return tuple(self.sample(item, self._stamp(arrived_ns, now_ns)) for item, arrived_ns in items)

    def silent(self, what: str) -> DeviceTimeoutError:
        """The error of a device that sends nothing."""
        return DeviceTimeoutError(
            self.name,
            what + self.silence_details(),
            port=self.place,
            expected=f"{self.expected}, {self.config.rate_hz:g} per second",
            remedy=self.remedy,
        )

    def silence_details(self) -> str:
        """Details of a silence, to be appended to the message of its error."""
        return ""

    def _stamp(self, arrived_ns: int, now_ns: int) -> Stamp:
        self._sequence += 1
        self._t_ns = max(arrived_ns - self._latency_ns, self._t_ns + 1)
        return Stamp(self._t_ns, now_ns, self._sequence)
