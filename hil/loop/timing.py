"""Measures the timing of a loop: durations of its sections, late and skipped cycles, in constant memory.

If many cycles begin late it gives a remedy.
"""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hil.core.clock import Clock

_BIN = math.log(1.01)
_BINS = round(math.log(1e11) / _BIN)
LOG = logging.getLogger(__name__)
_MANY = 0.05
_LOOK_AFTER_S = 2.0
_FULL = 0.7


class Distribution:
    """Mean, worst value and quantiles (to 1 %) of durations in ns, in a fixed amount of memory.

    Attributes:
        count: number of durations.
        worst_ns: the longest, 0 when empty.
    """

    def __init__(self) -> None:
        self._counts = [0] * _BINS
        self._total_ns = self.worst_ns = self.count = 0

    def add(self, value_ns: int, times: int = 1) -> None:
        """Add a duration `times` times; below 1 ns counts as 1 ns."""
        place = min(int(math.log(max(1, value_ns)) / _BIN), _BINS - 1)
        self._counts[place] += times
        self._total_ns += times * value_ns
        self.count += times
        self.worst_ns = max(self.worst_ns, value_ns)

    @property
    def mean_ns(self) -> float:
        """Mean duration, ns."""
        return self._total_ns / max(1, self.count)

    def quantile_ns(self, share: float) -> float:
        """Duration that a share (0 to 1) of all durations does not exceed, ns; 0 when empty."""
        if not self.count:
            return 0.0
        place = int(np.searchsorted(np.cumsum(self._counts), share * self.count))
        return min(math.exp((place + 1) * _BIN), float(self.worst_ns))


@dataclass
class LoopStatistics:
    """Timing statistics of a run.

    Attributes:
        late: cycles that began more than the allowed time after their deadline.
        overruns: cycles that were not done when the next was due.
        skipped: deadlines that were skipped.
    """

    cycles: int = 0
    late: int = 0
    overruns: int = 0
    skipped: int = 0
    _sections: dict[str, Distribution] = field(default_factory=dict, init=False, repr=False)
    _last_ns: Mapping[str, int] = field(default_factory=dict, init=False, repr=False)
    _again: int = field(default=0, init=False, repr=False)

    @property
    def sections(self) -> Mapping[str, Distribution]:
        """Durations of `read estimate control write sinks`, of their sum (`work`), and `lateness`."""
        self._count_last()
        return self._sections

    def add(self, timing_ns: Mapping[str, int]) -> None:
        """Add the durations of one cycle, not to be changed later. Equal cycles in a row are counted once.

        They are added with their number (`_count_last`); in virtual time most cycles are equal.
        """
        if timing_ns != self._last_ns:
            self._count_last()
            self._last_ns = timing_ns
        self._again += 1

    def _count_last(self) -> None:
        """Add the pending durations to the distributions, with their count."""
        times, self._again = self._again, 0
        for name, value_ns in self._last_ns.items() if times else ():
            found = self._sections.get(name)
            if found is None:
                found = self._sections[name] = Distribution()
            found.add(value_ns, times)

    def summary(self) -> dict[str, float]:
        """Counts, and mean, 99th percentile and worst per section (ms)."""
        out: dict[str, float] = {
            "cycles": self.cycles,
            "late": self.late,
            "overruns": self.overruns,
            "skipped": self.skipped,
        }
        for name, found in self.sections.items():
            out[f"{name}_mean_ms"] = found.mean_ns / 1e6
            out[f"{name}_p99_ms"] = found.quantile_ns(0.99) / 1e6
            out[f"{name}_worst_ms"] = found.worst_ns / 1e6
        return out


class Laps:
    """Stopwatch of one cycle: how long each section took, ns."""

    def __init__(self, clock: Clock, start_ns: int) -> None:
        self._now_ns, self._last_ns = clock.now_ns, start_ns
        self.timing_ns: dict[str, int] = {}

    def done(self, section: str) -> None:
        """Record the duration of a section that has ended."""
        now_ns = self._now_ns()
        self.timing_ns[section] = now_ns - self._last_ns
        self._last_ns = now_ns


def advice(timing: Mapping[str, float], rate_hz: float, burdens: Sequence[str] = ()) -> str:
    """Text on how many cycles began late and what to do about it; empty if few did.

    Args:
        timing: a summary of `LoopStatistics`.
        rate_hz: loop rate.
        burdens: given options that cost computing time.
    """
    if not timing["cycles"] or timing["late"] < _MANY * timing["cycles"]:
        return ""
    work_ms, period_ms = timing["work_mean_ms"], 1e3 / rate_hz
    said = f"{100.0 * timing['late'] / timing['cycles']:.0f} % of the cycles began late: "
    if work_ms > _FULL * period_ms:
        said += f"one takes {work_ms:.1f} ms of {period_ms:.1f} ms; "
        instead = f", or leave {' and '.join(burdens)} out" if burdens else ""
        return f"{said}lower loop.rate_hz in the bench file{instead}"
    return (
        f"{said}other programs keep this computer busy; end them, or set loop.fifo_priority and loop.cpu "
        "in the bench file (docs/live.md, Real time)"
    )


class LateWarning:
    """Warns once when many cycles of a session begin late.

    Args:
        rate_hz: loop rate.
        burdens: given options that cost computing time.
    """

    def __init__(self, rate_hz: float, burdens: Sequence[str] = ()) -> None:
        self._rate_hz, self._burdens = rate_hz, burdens
        self._next = int(_LOOK_AFTER_S * rate_hz)

    def look(self, statistics: LoopStatistics) -> None:
        """Check the statistics every two seconds, until a warning was logged."""
        if not self._next or statistics.cycles < self._next:
            return
        self._next += int(_LOOK_AFTER_S * self._rate_hz)
        said = advice(statistics.summary(), self._rate_hz, self._burdens)
        if said:
            self._next = 0
            LOG.warning("%s", said)
