"""The data of one cycle that all checks share, and the protocol of a check."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from hil.core.clock import nanoseconds
from hil.core.errors import SafetyStop
from hil.core.signals import Event, Inputs, Measurements, Reference, RobotState, Status, worst
from hil.core.suspects import suspects_of

Inflation = tuple[float, float]
"""By how much an estimate may be off: m along each axis, rad of the heading."""
NO_INFLATION: Inflation = (0.0, 0.0)
_PAUSED, _STALE = "held_up", "stale_"
"""After a long pause of the loop itself, devices that nothing asked meanwhile are no silent ones."""


@dataclass
class LastCycle:
    """All that one cycle leaves to the next.

    Attributes:
        heading_rad: of the estimate.
        wheel_rate_rad_s: (4,) as commanded.
        inflation: of the estimate, by what was found about it.
    """

    heading_rad: float = 0.0
    wheel_rate_rad_s: list[float] = field(default_factory=lambda: [0.0] * 4)
    inflation: Inflation = NO_INFLATION


@dataclass
class Cycle:
    """What checks see of a cycle, and where they report.

    Attributes:
        inputs: samples of all devices.
        measurements: the same, aligned in the body frame.
        last: what the cycle before has left.
        state, reference, observers: estimate, reference and estimates that are not followed; there once the
            estimate has been made.
        inflation: of the estimate of this cycle.
        events: reported in this cycle.
        stops: by reason, the messages of what the robot must stop for; the first reason names the stop.
        suspects: devices that the messages name.
        diagnostics: figures by name, which go into the robot's state (`RobotState.diagnostics`): what
            `on_samples` has put there.
        next_inflation: of the estimate of the next cycle.
        source: the device whose check runs; empty for the bench's own.
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
        """The robot must stop.

        Args:
            reason: one word, `snake_case`: it names the stop in results and on pages.
            message: what was found, and what to do.
            suspects: devices that may be the cause, beside those that the reason names.
        """
        known = self.stops.get(reason)
        self.stops[reason] = message if known is None else f"{known}; {message}"
        self.suspects.update(suspects)
        if self.source:
            self.suspects.add(self.source)

    def warn(self, message: str) -> None:
        """Report something for which the robot need not stop."""
        self.events.append(Event(self.inputs.t_ns, "warning", self.source, message))

    def inflate(self, off_m: float, off_rad: float) -> None:
        """The estimate of this cycle may be off by so much."""
        self.inflation = (max(self.inflation[0], off_m), max(self.inflation[1], off_rad))

    def inflate_next(self, off: Inflation) -> None:
        """The estimate of the next cycle may be off by so much."""
        self.next_inflation = (max(self.next_inflation[0], off[0]), max(self.next_inflation[1], off[1]))

    def must_go_on(self, context: str) -> None:
        """Raise one `SafetyStop` for all that was found; `context` ends its message."""
        if _PAUSED in self.stops:
            self.stops = {k: v for k, v in self.stops.items() if not k.startswith(_STALE)}
        if self.stops:
            (reason, message), *others = self.stops.items()
            suspects = {*self.suspects, *(name for also, _ in others for name in suspects_of(also))}
            text = "; ".join([message, *(f"also {k}: {v}" for k, v in others)]) + context
            raise SafetyStop(reason, text, sorted(suspects))


def go_on(reason: str, message: str) -> None:
    """In place of `Cycle.stop` where the robot need not stop: the event of the finding is enough."""


class Check:
    """Base of all checks: each overrides one of the two methods, or both.

    A check depends on the cycles since `reset` and on nothing else, so that replay finds the same. It reports
    by `Cycle.stop`, `Cycle.warn`, `Cycle.events` and the two inflations. It does not know the loop.
    """

    def reset(self) -> None:
        """Forget all that was seen in the run."""

    def on_samples(self, cycle: Cycle) -> None:
        """Judge what the devices delivered, before the estimate."""

    def on_estimate(self, cycle: Cycle) -> None:
        """Judge the estimate, before anything is commanded."""


class LastingCheck(Check):
    """Stops once good samples of one kind have been wrong for a while; others do not count.

    Samples of `servos` have angles, rates and currents. Voltages and temperatures of the servos come in
    `cycle.inputs.health`, once per `servos.health_period_s` (s), and health is no kind: a check of these is a
    `Check` that reads them there.

    Args:
        kind: of the device.
        reason: names the stop.
        wrong: what is wrong with a sample, in words; empty where nothing is.
        for_s: for how long without a sample that is right; 0 for the first one that is wrong.
    """

    def __init__(self, kind: str, reason: str, wrong: Callable[[Any], str], for_s: float = 0.0) -> None:
        self.kind, self.reason, self._wrong = kind, reason, wrong
        self._limit_ns = nanoseconds(for_s)
        self.reset()

    def reset(self) -> None:
        """Forget all that was seen in the run."""
        self._since_ns: int | None = None

    def on_samples(self, cycle: Cycle) -> None:
        """Look at the samples of its kind."""
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
