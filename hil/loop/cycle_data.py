"""The data of one cycle that all checks share, and the protocol of a check."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from hil.core.clock import nanoseconds
from hil.core.errors import SafetyStop
from hil.core.signals import Event, Inputs, Measurements, Reference, RobotState, Status, worst
from hil.core.stop_suspects import suspects_of

Inflation = tuple[float, float]
"""Largest error of an estimate: m along each axis, rad of the heading."""
NO_INFLATION: Inflation = (0.0, 0.0)
_PAUSED, _STALE = "held_up", "stale_"
SILENT = (_STALE, "lost_")
"""What reasons begin with that name a silent device."""
"""After a long pause of the loop itself, devices that were not read meanwhile do not count as silent."""


@dataclass
class LastCycle:
    """Data that one cycle passes to the next.

    Attributes:
        heading_rad: heading of the estimate.
        wheel_rate_rad_s: (4,) commanded wheel rates.
        inflation: inflation for the next estimate, from checks of this one.
    """

    heading_rad: float = 0.0
    wheel_rate_rad_s: list[float] = field(default_factory=lambda: [0.0] * 4)
    inflation: Inflation = NO_INFLATION


@dataclass
class Cycle:
    """The input of the checks in a cycle, and their results.

    Attributes:
        inputs: samples of all devices.
        measurements: the same samples, aligned in the body frame.
        last: data from the previous cycle.
        state, reference, observers: estimate, reference, and estimates that are not followed; set after the
            estimate.
        inflation: inflation of this cycle's estimate.
        events: events of this cycle.
        stops: messages of stop conditions, by reason; the first reason names the stop.
        suspects: devices that the messages name.
        diagnostics: figures by name that `on_samples` added, for the robot's state
            (`RobotState.diagnostics`).
        next_inflation: inflation of the next cycle's estimate.
        source: the device whose check runs; empty for checks of the bench.
    """

    inputs: Inputs
    measurements: Measurements
    last: LastCycle = field(default_factory=LastCycle)
    state: RobotState | None = None
    reference: Reference | None = None
    observers: Mapping[str, RobotState] = field(default_factory=dict)
    inflation: Inflation = NO_INFLATION
    events: list[Event] = field(default_factory=list)
    stops: dict[str, str] = field(default_factory=dict)
    suspects: set[str] = field(default_factory=set)
    diagnostics: dict[str, float] = field(default_factory=dict)
    next_inflation: Inflation = NO_INFLATION
    source: str = ""

    def stop(self, reason: str, message: str, suspects: Iterable[str] = ()) -> None:
        """Report a condition for which the robot must stop.

        Args:
            reason: one word in `snake_case`; names the stop in results and on pages.
            message: finding and remedy, in words.
            suspects: devices that may be the cause, besides those that the reason implies.
        """
        known = self.stops.get(reason)
        self.stops[reason] = message if known is None else f"{known}; {message}"
        self.suspects.update(suspects)
        if self.source:
            self.suspects.add(self.source)

    def warn(self, message: str) -> None:
        """Report a warning for which the robot need not stop."""
        self.events.append(Event(self.inputs.t_ns, "warning", self.source, message))

    def inflate(self, off_m: float, off_rad: float) -> None:
        """Report the largest error of this cycle's estimate (m, rad)."""
        self.inflation = (max(self.inflation[0], off_m), max(self.inflation[1], off_rad))

    def inflate_next(self, off: Inflation) -> None:
        """Report the largest error of the next cycle's estimate (m, rad)."""
        self.next_inflation = (max(self.next_inflation[0], off[0]), max(self.next_inflation[1], off[1]))

    def must_go_on(self, context: str) -> None:
        """Raise one `SafetyStop` for all stop conditions, if there are any; `context` ends its message."""
        if _PAUSED in self.stops:
            self.stops = {k: v for k, v in self.stops.items() if not k.startswith(_STALE)}
        if self.stops:
            (reason, message), *others = self.stops.items()
            suspects = {*self.suspects, *(name for also, _ in others for name in suspects_of(also))}
            text = "; ".join([message, *(f"also {k}: {v}" for k, v in others)])
            raise SafetyStop(reason, text + context * (reason != _PAUSED), sorted(suspects))


def go_on(reason: str, message: str) -> None:
    """Does nothing; used in place of `Cycle.stop` where the event alone is enough."""


class Check:
    """Base of all checks: each overrides one of the two methods, or both.

    A check depends only on the cycles since `reset`, so that replay gives the same result. It reports by
    `Cycle.stop`, `Cycle.warn`, `Cycle.events` and the two inflations. It has no access to the loop.
    """

    def reset(self) -> None:
        """Clear the state of the run."""

    def on_samples(self, cycle: Cycle) -> None:
        """Check the devices' samples, before the estimate."""

    def on_estimate(self, cycle: Cycle) -> None:
        """Check the estimate, before commands are computed."""


class LastingCheck(Check):
    """Stops when good samples of one kind have shown a fault for a while; other samples do not count.

    Samples of `servos` have angles, rates and currents. Voltages and temperatures of the servos come in
    `cycle.inputs.health`, once per `servos.health_period_s` (s), and health is not a kind: to check it,
    derive from `Check` and read it there.

    Args:
        kind: the device's kind.
        reason: names the stop.
        wrong: text on the fault that a sample shows; empty for none.
        for_s: duration without a sample free of the fault, s; 0 to stop at the first faulty one.
    """

    def __init__(self, kind: str, reason: str, wrong: Callable[[Any], str], for_s: float = 0.0) -> None:
        self.kind, self.reason, self._wrong = kind, reason, wrong
        self._limit_ns = nanoseconds(for_s)
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._since_ns: int | None = None

    def on_samples(self, cycle: Cycle) -> None:
        """Check the samples of its kind."""
        for sample in cycle.inputs.of(self.kind):
            if worst(sample) is not Status.OK:
                continue
            reported, t_ns = self._wrong(sample), sample.stamp.t_ns
            if not reported:
                self._since_ns = None
                continue
            self._since_ns = t_ns if self._since_ns is None else self._since_ns
            if t_ns - self._since_ns >= self._limit_ns:
                cycle.stop(self.reason, reported)
