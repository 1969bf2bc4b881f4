"""Tells damaged messages on a wire from what they seem to report: values that jump there and back at once.

A fan cannot change its speed by a fifth from one report to the next, nor its battery its voltage. A message
that says so between two that agree is damaged: the wire is to be looked at, not the fan. Only wires whose
messages have no checksum of their own need this. Deterministic: depends only on the inputs since `reset`.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.signals import AdhesionSample, Event, Status, worst
from hil.loop.cycle_data import Check, Cycle


def _speed_rpm(sample: AdhesionSample) -> float:
    """Reported speed; infinite where it was beyond a physical bound."""
    return math.inf if sample.status is Status.IMPLAUSIBLE else sample.speed_rpm


_VALUES: Mapping[str, Callable[[Any], tuple[float, ...]]] = {
    "adhesion": lambda sample: (
        _speed_rpm(sample),
        sample.fet_c,
        sample.motor_c,
        sample.input_v,
        sample.duty,
    ),
    "load_cells": lambda sample: (sum(sample.force_n.tolist()),),
}
"""Values of the samples of a kind that change slowly, or come back slowly."""
_SLOW = {"adhesion": 3, "load_cells": 0}
"""Number of these values that cannot step at all: speed and temperatures."""
_REPORTS = (Status.OK, Status.IMPLAUSIBLE)
_SPIKE, _SAME = 0.2, 0.05
"""A spike differs from both neighbours by more than the first share of them, and they from each other by less
than the second.
"""
_WITHIN_NS, _FEWEST = nanoseconds(5.0), 3
"""A warning is given for so many spikes within this time."""


class DamagedReports(Check):
    """Counts spikes; adds them to a stop for another reason, which they may have caused."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._last: dict[str, deque[tuple[float, ...]]] = {name: deque(maxlen=3) for name in _VALUES}
        self._spikes: dict[str, deque[int]] = {name: deque(maxlen=_FEWEST) for name in _VALUES}
        self._quiet_ns = dict.fromkeys(_VALUES, 0)

    def on_samples(self, cycle: Cycle) -> None:
        """Look at the samples of a cycle."""
        t_ns = cycle.inputs.t_ns
        for name, values_of in _VALUES.items():
            samples, last, spikes = cycle.inputs.of(name), self._last[name], self._spikes[name]
            if not (samples or spikes or cycle.stops):
                continue
            for sample in samples:
                if worst(sample) in _REPORTS:
                    last.append(values_of(sample))
                    if len(last) == 3 and _is_spike(*last):
                        spikes.append(t_ns)
            recent = [at_ns for at_ns in spikes if t_ns - at_ns <= _WITHIN_NS]
            if len(recent) == _FEWEST and t_ns >= self._quiet_ns[name]:
                self._quiet_ns[name] = t_ns + _WITHIN_NS
                span_s = (t_ns - recent[0]) / NS_PER_S
                cycle.events.append(Event(t_ns, "warning", name, _text(len(recent), span_s)))
            if cycle.stops:
                self._add_to_stop(cycle, name, len(recent))

    def _add_to_stop(self, cycle: Cycle, name: str, recent: int) -> None:
        """Name reports that jumped as a cause of a stop, if some did."""
        last = self._last[name]
        jumps = len(last) > 1 and _is_step(last[-2][: _SLOW[name]], last[-1])
        if recent or jumps:
            cycle.stop("damaged_reports", f"{name}: {_text(recent + jumps, _WITHIN_NS / NS_PER_S)}", [name])


def _text(count: int, within_s: float) -> str:
    return (
        f"in {within_s:.1f} s {count} of its reports jumped as nothing real does: messages are damaged on "
        "the wire; look at its plugs, shield, termination and bit rate"
    )


def _is_step(before: tuple[float, ...], now: tuple[float, ...]) -> bool:
    """Whether a value differs from the one before it as a spike does."""
    return any(abs(b - a) > _SPIKE * abs(a) for a, b in zip(before, now, strict=False))


def _is_spike(before: tuple[float, ...], middle: tuple[float, ...], after: tuple[float, ...]) -> bool:
    """Whether a value in the middle differs from both neighbours, which are the same."""
    for a, b, c in zip(before, middle, after, strict=True):
        scale = max(abs(a), abs(c))
        if abs(c - a) <= _SAME * scale and min(abs(b - a), abs(b - c)) > _SPIKE * scale:
            return True
    return False
