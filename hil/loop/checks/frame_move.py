"""Finds out that the frame of motion capture has moved: its poses jump, and stay where they are then.

A rigid body that was defined anew, or two markers taken for each other, move the frame. Poses before
and after that cannot be compared. Deterministic: depends only on the measurements since `reset`.
"""

import math

from hil.core.clock import NS_PER_S, nanoseconds
from hil.loop.checks.exclusion import Exclusion
from hil.loop.checks.mocap_agreement import CAPTURE
from hil.loop.cycle_data import Check, Cycle

_STAYS_NS = nanoseconds(0.1)
"""A frame that is back before this has not moved: a marker was mistaken for a moment."""
_SHORTEST_NS = nanoseconds(0.0005)
"""Samples closer together than this are one: noise over so short a time is no speed. Late frames come so."""


class Steps:
    """Follows the steps between the samples of a value, and sums those that no robot can make.

    A steady motion makes steps that are alike by time or by number: a source that stamps its frames late
    sends them at even times all the same, and one that numbers only what it sends leaves frames out.

    Args:
        slack: largest change of a step that is noise: ten times that of a good system.
        pull: largest acceleration, per s^2.
        gap_s: time without samples after which it begins anew, s.
    """

    def __init__(self, slack: float, pull: float, gap_s: float) -> None:
        self._slack, self._pull, self._gap_ns = slack, pull, nanoseconds(gap_s)
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._last: tuple[int, int, complex] | None = None
        self._step: tuple[float, int, complex] | None = None
        self._off = 0j
        self._since_ns = 0

    def take(self, t_ns: int, number: int, value: complex) -> None:
        """Compare the step to this value, with its stamp and sequence number, with the one before it."""
        last = self._last
        if last is not None and 0 < t_ns - last[0] < _SHORTEST_NS:
            return
        self._last = (t_ns, number, value)
        if last is None or not 0 < t_ns - last[0] <= self._gap_ns:
            self._step = None
            return
        dt_s, frames, step = (t_ns - last[0]) / NS_PER_S, max(1, number - last[1]), value - last[2]
        before, self._step = self._step, (dt_s, frames, step)
        if before is None:
            return
        off = min((step - before[2] * ratio for ratio in (dt_s / before[0], frames / before[1])), key=abs)
        if abs(off) > self._slack + 0.5 * self._pull * dt_s * (dt_s + before[0]):
            self._off, self._since_ns = self._off + off, t_ns
            self._step = before

    def moved(self, t_ns: int) -> float:
        """Size of the sum, once it has stayed; else 0."""
        size = abs(self._off)
        return size if size > self._slack and t_ns - self._since_ns >= _STAYS_NS else 0.0


class FrameMove(Check):
    """Follows the poses of motion capture.

    Half of gravity is the acceleration of a robot that falls; it makes no turns of that kind.

    Args:
        excluded: record of the excluded devices; takes motion capture if its frame has moved.
    """

    def __init__(self, excluded: Exclusion) -> None:
        self._excluded = excluded
        self._places, self._turns = Steps(0.004, 5.0, 0.05), Steps(0.03, 5.0, 0.3)
        self._reported = False

    def reset(self) -> None:
        """Clear the state of the run."""
        self._places.reset()
        self._turns.reset()
        self._reported = False

    def on_samples(self, cycle: Cycle) -> None:
        """Follow the poses of a cycle; reports a moved frame once."""
        if self._reported:
            return
        for pose in cycle.measurements.mocap:
            x_m, y_m, heading_rad = pose.pose.tolist()
            if math.isfinite(x_m + y_m):
                self._places.take(pose.stamp.t_ns, pose.stamp.seq, complex(x_m, y_m))
            if math.isfinite(heading_rad):
                self._turns.take(pose.stamp.t_ns, pose.stamp.seq, complex(heading_rad, 0.0))
        way_m, turn_rad = (steps.moved(cycle.inputs.t_ns) for steps in (self._places, self._turns))
        if way_m or turn_rad:
            self._reported = True
            by = f"{1e3 * way_m:.0f} mm" if way_m else f"{math.degrees(turn_rad):.1f} deg"
            message = (
                f"its frame has moved by {by} in one step: its poses count for nothing from now on; look at "
                "mocap.body and its markers"
            )
            self._excluded.take_moved(CAPTURE.name, message, cycle)
