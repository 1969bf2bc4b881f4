"""Follows motion capture out of the plane of motion: a robot on its wheels stays in it.

With the other up axis, or a plane that is not the wall, the robot seems to leave the wall, or to tip. That
shows as soon as it moves across or turns. Deterministic: depends only on the samples since `reset`.
"""

from __future__ import annotations

import math

from hil.core.signals import Event, MocapSample, Status
from hil.loop.cycle_data import Check, Cycle

_MOST_M, _MOST_RAD = 0.015, 0.07
"""Motion out of the plane, and tilt of the robot in it, that a good plane and body have; robots tip less."""
_AGAIN = 5


def tipped_rad(sample: MocapSample) -> float:
    """Angle between the rigid body's z axis and the normal of the plane, rad."""
    _, x, y, _ = sample.quaternion_wxyz.tolist()
    return math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y))))


class OutOfPlane(Check):
    """Checks motion capture in one run; reports once."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._first_m: float | None = None
        self._seen = 0
        self._reported = False

    def on_samples(self, cycle: Cycle) -> None:
        """Follow the samples of a cycle."""
        for sample in cycle.inputs.mocap:
            if not self._reported and sample.status is Status.OK and sample.tracking_valid:
                self._follow(sample, cycle)

    def _follow(self, sample: MocapSample, cycle: Cycle) -> None:
        z_m, tipped = sample.position_m.item(2), tipped_rad(sample)
        if self._first_m is None:
            self._first_m = z_m
        left_m = abs(z_m - self._first_m)
        self._seen = self._seen + 1 if left_m > _MOST_M or tipped > _MOST_RAD else 0
        if self._seen < _AGAIN:
            return
        self._reported = True
        found = f"{1e3 * left_m:.0f} mm off its plane, tipped by {math.degrees(tipped):.1f} deg"
        message = (
            f"motion capture sees the robot {found}, and its wheels stay on it: look at mocap.up_axis, at "
            "the plane, and at the axes of mocap.body"
        )
        cycle.events.append(
            Event(cycle.inputs.t_ns, "warning", "mocap", message, key="mocap.up_axis, mocap.body")
        )
