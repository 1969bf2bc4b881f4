"""Finds the wheel that contradicts the other three: its hub slips, or its servo reports wrong values.

The motion of the body has three unknowns and the wheels measure eight values: any three wheels determine how
far the fourth has to roll. Healthy wheels of a driven robot agree within 0.6 mm in 0.4 s, on both plants,
because all four are commanded by one motion. A wheel that begins to slip deviates by millimetres until its
motor has returned to its speed; then the slip is no longer visible although it continues, so that the
covariance is increased from then on by a share of the distance. A wheel that has slipped from the start is
not found. Deterministic: depends only on the samples since `reset`.
"""

import math
from collections import deque

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.geometry import Array, nearest_turn
from hil.core.signals import DRIVES, WHEELS, Event, WheelMeasurement
from hil.loop.checks.dead_reckoning import FASTEST_RAD_S, STEP_RAD
from hil.loop.cycle_data import Check, Cycle
from hil.robot.kinematics import WheelGeometry

_STEP_NS, _WINDOW_NS = 78_000_000, 400_000_000
_APART_M, _APART_SHARE, _AGAIN = 0.0008, 0.02, 2
"""Limit above the residual of good wheels (0.05 mm on a line, 0.55 mm where an arc begins or ends), addition
per metre, and required number of successive detections. Directions of steered wheels are delayed.
"""
_SWUNG_RAD = 0.1
"""Steering angle per step above which the rolled distance does not count."""
_AT_ONCE_M, _WAY_SHARE, _WIDEN_M = 0.003, 0.05, 0.003
"""Uncertainty of the estimate when one wheel of four slips, addition per metre, and step size: the error
grows by a tenth of the distance, for any share of slip.
"""


class WheelSlipCheck(Check):
    """Checks the wheels of one run.

    Args:
        geometry: wheel geometry.
        ids: bus IDs in the order of `SERVOS`; empty when unknown.

    Attributes:
        reported: True if a wheel of this run has been reported.
    """

    def __init__(self, geometry: WheelGeometry, ids: tuple[int, ...] = ()) -> None:
        named = [f", ID {i}" for i in ids[:4]] or [""] * 4
        self._names = [f"wheel {w} ({s}{i})" for w, s, i in zip(WHEELS, DRIVES, named, strict=True)]
        self._radius_m = geometry.radius_m.tolist()
        self._zero_rad = geometry.steering_zero_rad.tolist()
        self._others = _by_the_others(np.asarray(geometry.projection()))
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._forget()
        self.reported = self._doubted = False
        self._way_m = self._since_m = self._sigma_m = self._off_m = 0.0

    def _forget(self) -> None:
        """Clear the last sample and the window."""
        self._last: tuple[int, list[float], list[float]] | None = None
        self._steps: deque[tuple[int, list[float], list[float], float]] = deque()
        self._rolled_m, self._said_m, self._loose_m = [0.0] * 4, [0.0] * 4, 0.0
        self._suspect, self._seen = -1, 0

    def take_inflation(self) -> tuple[float, float]:
        """Estimate error found since the last call (m, rad); resets it."""
        off_m, self._off_m = self._off_m, 0.0
        return off_m, 0.0

    def doubt(self) -> None:
        """Note that other sensors show wheel slip, perhaps since the start of the run."""
        self._doubted = True

    def on_samples(self, cycle: Cycle) -> None:
        """Compare each wheel with the other three."""
        self.judge(cycle.inputs.t_ns, cycle.measurements.wheels, cycle.events)
        cycle.inflate_next(self.take_inflation())

    def judge(self, t_ns: int, samples: tuple[WheelMeasurement, ...], events: list[Event]) -> None:
        """Check one cycle's wheels; adds findings to `events`."""
        for sample in samples:
            if self._take(sample):
                self._compare(t_ns, events)
                self._widen()

    def _take(self, sample: WheelMeasurement) -> bool:
        """Process a sample; return whether a step was completed. Incomplete samples are skipped."""
        t_ns, last = sample.stamp.t_ns, self._last
        if last is not None and t_ns - last[0] < _STEP_NS:
            return False
        angles: list[float] = sample.wheel_angle_rad.tolist()
        steering: list[float] = sample.steering_rad.tolist()
        if not (all(sample.valid) and math.isfinite(sum(angles) + sum(steering))):
            return False
        if last is None:
            self._last = (t_ns, angles, steering)
            return False
        steering = [nearest_turn(a, b) for a, b in zip(steering, last[2], strict=True)]
        possible = FASTEST_RAD_S * (t_ns - last[0]) / NS_PER_S + STEP_RAD
        turned = [a - b for a, b in zip(angles + steering, last[1] + last[2], strict=True)]
        if max(turned) > possible or min(turned) < -possible:
            self._forget()
        else:
            middle = [0.5 * (a + b) - z for a, b, z in zip(steering, last[2], self._zero_rad, strict=True)]
            rolled_m = [a * r for a, r in zip(turned[:4], self._radius_m, strict=True)]
            loose_m = max(abs(r * a) for r, a in zip(rolled_m, turned[4:], strict=True))
            if max(turned[4:]) > _SWUNG_RAD or min(turned[4:]) < -_SWUNG_RAD:
                loose_m += max(map(abs, rolled_m))
            self._roll(t_ns, rolled_m, middle, loose_m)
        self._last = (t_ns, angles, steering)
        return True

    def _roll(self, t_ns: int, rolled_m: list[float], angle_rad: list[float], loose_m: float) -> None:
        """Add a step (4,) along the wheel directions to the window, and drop old steps.

        Args:
            t_ns: end of the step.
            rolled_m: (4,) rolled distances.
            angle_rad: (4,) directions.
            loose_m: possible error because the directions change during the step.
        """
        c, s = [math.cos(a) for a in angle_rad], [math.sin(a) for a in angle_rad]
        u = [part * r for r, *parts in zip(rolled_m, c, s, strict=True) for part in parts]
        said = (self._others @ u).tolist()
        said_m = [x * ci + y * si for x, y, ci, si in zip(said[::2], said[1::2], c, s, strict=True)]
        self._steps.append((t_ns, rolled_m, said_m, loose_m))
        self._add(rolled_m, said_m, loose_m, 1.0)
        while self._steps[0][0] <= t_ns - _WINDOW_NS:
            _, old_m, was_m, open_m = self._steps.popleft()
            self._add(old_m, was_m, open_m, -1.0)
        self._way_m += 0.25 * sum(map(abs, rolled_m))

    def _add(self, rolled_m: list[float], said_m: list[float], loose_m: float, sign: float) -> None:
        self._loose_m += sign * loose_m
        self._rolled_m = [a + sign * b for a, b in zip(self._rolled_m, rolled_m, strict=True)]
        self._said_m = [a + sign * b for a, b in zip(self._said_m, said_m, strict=True)]

    def _compare(self, t_ns: int, events: list[Event]) -> None:
        """Report the wheel with the largest deviation from the other three, if it exceeds the limit."""
        apart = [abs(a - b) for a, b in zip(self._rolled_m, self._said_m, strict=True)]
        worst = max(range(4), key=apart.__getitem__)
        if apart[worst] <= _APART_M + _APART_SHARE * abs(self._said_m[worst]) + self._loose_m:
            self._suspect, self._seen = -1, 0
            return
        self._seen = self._seen + 1 if worst == self._suspect else 1
        self._suspect = worst
        if self.reported or self._seen < _AGAIN:
            return
        self.reported = True
        if not self._doubted:
            self._doubted, self._since_m = True, self._way_m
        rolled_mm, said_mm = 1e3 * self._rolled_m[worst], 1e3 * self._said_m[worst]
        share = f" ({100.0 * rolled_mm / said_mm:.0f} %)" if abs(said_mm) > 1.0 else ""
        said = (
            f"{self._names[worst]} rolled {rolled_mm:.1f} mm in {_WINDOW_NS / NS_PER_S:.1f} s and the other "
            f"three say {said_mm:.1f} mm{share}: it slips or its servo is wrong, check hub and horn; the "
            f"estimate is unsure by {1e3 * _AT_ONCE_M:.0f} mm and {100.0 * _WAY_SHARE:.0f} % of the way more"
        )
        events.append(Event(t_ns, "warning", "servos", said))

    def _widen(self) -> None:
        """Increase the covariance with the distance after a slip, in steps."""
        if not self._doubted:
            return
        wanted_m = _AT_ONCE_M + _WAY_SHARE * (self._way_m - self._since_m)
        if wanted_m >= self._sigma_m + _WIDEN_M:
            self._off_m = math.sqrt(self._off_m**2 + wanted_m**2 - self._sigma_m**2)
            self._sigma_m = wanted_m


def _by_the_others(projection: Array) -> Array:
    """Matrix (8, 8): displacements (x, y) of each wheel from those of the three others."""
    found = np.zeros((8, 8))
    for i in range(4):
        rows = [k for k in range(8) if k // 2 != i]
        found[2 * i : 2 * i + 2, rows] = projection[2 * i : 2 * i + 2] @ np.linalg.pinv(projection[rows])
    return found
