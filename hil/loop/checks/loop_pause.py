"""Checks whether the control loop itself paused: the program was stopped, or the computer was too busy.

Meanwhile the servos' watchdogs trip and buffers run over: healthy devices look silent or jump. So a long
pause stops the robot with a reason of its own, and a shorter one is named beside the reason of a stop.
"""

from __future__ import annotations

from hil.core.clock import NS_PER_S
from hil.core.interfaces import ReportStop
from hil.loop.cycle_data import Check, Cycle

HELD_UP_NS = 500_000_000
_PAUSE_NS, _PAUSE_CYCLES, _FRESH_NS = 60_000_000, 3, 1_000_000_000
"""Pauses that are named beside a stop: longer than so much and so many cycles, and over for no longer."""


def stood_still(gap_ns: int) -> str:
    """Says that no cycle began for so long, and what to do."""
    return (
        f"the control loop stood still for {gap_ns / NS_PER_S:.1f} s: this program was stopped, or "
        "the computer had no time for it. Look for what else ran, then start the motion again"
    )


class LoopPause(Check):
    """Follows the cycles of one run."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all that was seen before."""
        self._last_ns: int | None = None
        self._cycle_ns = self._ended_ns = self._lasted_ns = 0

    def on_samples(self, cycle: Cycle) -> None:
        """The time of the cycle."""
        self.judge(cycle.inputs.t_ns, cycle.stop)

    def judge(self, t_ns: int, stop: ReportStop) -> None:
        """Take the time of a cycle.

        Args:
            t_ns: of the cycle.
            stop: called with the reason to stop: it is not known what the robot did during a long pause, and
                its servos' watchdogs have stopped it.
        """
        before_ns, self._last_ns = self._last_ns, t_ns
        if before_ns is None:
            return
        gap_ns = t_ns - before_ns
        if gap_ns > HELD_UP_NS:
            self._lasted_ns = 0  # has a reason of its own
            stop("held_up", stood_still(gap_ns))
        elif self._cycle_ns and gap_ns > _PAUSE_NS and gap_ns > _PAUSE_CYCLES * self._cycle_ns:
            self._ended_ns, self._lasted_ns = t_ns, gap_ns
        if gap_ns < self._cycle_ns or not self._cycle_ns:
            self._cycle_ns = gap_ns

    def beside(self, t_ns: int) -> str:
        """What is to be said beside a stop for another reason; empty where no pause came before it."""
        if not self._lasted_ns or t_ns - self._ended_ns > _FRESH_NS:
            return ""
        return (
            f"; the control loop had stood still for {self._lasted_ns / NS_PER_S:.2f} s just before. Where "
            "no device held it up, look first for what else ran on this computer: it makes healthy devices "
            "look silent"
        )
