"""Says how many cycles of a session begin late, and what to do: once while it runs, and at its end."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

from hil.loop.timing import LoopStatistics

LOG = logging.getLogger(__name__)

_MANY = 0.05
_LOOK_AFTER_S = 2.0
_FULL = 0.7


def advice(timing: Mapping[str, float], rate_hz: float, burdens: Sequence[str] = ()) -> str:
    """How many cycles began late and what to do about it; empty where few did.

    Args:
        timing: a summary of `LoopStatistics`.
        rate_hz: of the loop.
        burdens: options that were given and cost time.
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
        rate_hz: of the loop.
        burdens: options that were given and cost time.
    """

    def __init__(self, rate_hz: float, burdens: Sequence[str] = ()) -> None:
        self._rate_hz, self._burdens = rate_hz, burdens
        self._next = int(_LOOK_AFTER_S * rate_hz)

    def look(self, statistics: LoopStatistics) -> None:
        """Look at the cycles so far, every two seconds until there was something to say."""
        if not self._next or statistics.cycles < self._next:
            return
        self._next += int(_LOOK_AFTER_S * self._rate_hz)
        said = advice(statistics.summary(), self._rate_hz, self._burdens)
        if said:
            self._next = 0
            LOG.warning("%s", said)
