"""Dead reckoning by the wheels alone and by the gyro alone, with a history to compare with other sensors.

Camera poses arrive tens of milliseconds late; for a comparison, the other sensors' values at that time are
needed.
"""

import cmath
import math
from bisect import bisect_right

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.geometry import nearest_turn
from hil.core.signals import GyroMeasurement, WheelMeasurement
from hil.robot.kinematics import WheelGeometry

_KEPT = 256
_GYRO_GAP_NS = 100_000_000
_WHEEL_NS = 28_000_000
STEP_RAD, FASTEST_RAD_S = 0.2, 6.5
"""A joint turns in a step by no more than this angle plus this rate times the duration: else an encoder has
slipped. The rate is above that of an XH430 without load at 12 V; the angle covers a stamp error of 30 ms.
"""

Kept = tuple[complex, ...]


class Track:
    """Time series of values; keeps the newest `_KEPT`.

    Attributes:
        newest_ns: time of the newest values; None without any.
    """

    def __init__(self) -> None:
        self.clear()

    def reset(self) -> None:
        """Remove all values."""
        self.clear()

    def clear(self) -> None:
        """Remove all values."""
        self._times: list[int] = []
        self._values: list[Kept] = []
        self.newest_ns: int | None = None

    def put(self, t_ns: int, values: Kept) -> None:
        """Add the newest values; their time is not before that of the last."""
        times = self._times
        times.append(t_ns)
        self._values.append(values)
        self.newest_ns = t_ns
        if len(times) >= 2 * _KEPT:
            del times[:-_KEPT], self._values[:-_KEPT]

    def covers(self, t_ns: int) -> bool:
        """Whether the series has no gap since a time."""
        times = self._times
        return bool(times) and times[max(0, len(times) - _KEPT)] <= t_ns

    def at(self, t_ns: int) -> Kept | None:
        """Values at a time, interpolated; None outside the series."""
        if self.newest_ns is None or t_ns > self.newest_ns:
            return None
        times = self._times
        k = bisect_right(times, t_ns) - 1
        if k < 0 or k < len(times) - _KEPT:
            return None
        at_ns, values = times[k], self._values[k]
        if at_ns == t_ns:
            return values
        part = (t_ns - at_ns) / (times[k + 1] - at_ns)
        return tuple([a + part * (b - a) for a, b in zip(values, self._values[k + 1], strict=True)])


def moved(before: Kept, now: Kept) -> tuple[complex, float]:
    """Displacement (m, complex) in the body axes at the start, and turn (rad), between two instants.

    Args:
        before: values that begin with position (m, complex) and heading (rad).
        now: values at the end, as `before`.
    """
    return (now[0] - before[0]) * cmath.rect(1.0, -before[1].real), (now[1] - before[1]).real


def rolled(before: Kept, now: Kept) -> tuple[float, float]:
    """Rolled distance and contradiction (m) between two values of a `WheelTrack`."""
    return (now[2] - before[2]).real, (now[3] - before[3]).real


class WheelTrack(Track):
    """Integrates position (m, complex), heading (rad), rolled distance (m) and contradiction (m).

    The contradiction is the residual of the wheel that fits the body's motion worst: the possible error of
    the motion.

    Args:
        geometry: wheel geometry.
    """

    def __init__(self, geometry: WheelGeometry) -> None:
        super().__init__()
        forward = np.linalg.pinv(geometry.projection())
        along, turn = forward[0] + 1j * forward[1], forward[2]
        self._wheels: list[tuple[float, float, complex, complex, float, float, complex]] = [
            (radius, zero, *along[2 * i : 2 * i + 2].tolist(), *turn[2 * i : 2 * i + 2].tolist(), 1j * place)
            for i, (radius, zero, place) in enumerate(
                zip(
                    geometry.radius_m.tolist(),
                    geometry.steering_zero_rad.tolist(),
                    (geometry.x_m + 1j * geometry.y_m).tolist(),
                    strict=True,
                )
            )
        ]
        self.reset()

    def reset(self) -> None:
        """Reset the sums and the last wheel angles."""
        self.clear()
        self._last: tuple[int, list[float], list[float]] | None = None
        self._now: Kept = (0j, 0.0, 0.0, 0.0)

    def take(self, sample: WheelMeasurement) -> None:
        """Add a sample of all four wheels; incomplete samples are skipped.

        After a step that no motor can make in that time (a servo's encoder has slipped) the series restarts.
        """
        t_ns, last = sample.stamp.t_ns, self._last
        if last is not None and t_ns - last[0] < _WHEEL_NS:
            return
        angles: list[float] = sample.wheel_angle_rad.tolist()
        steering: list[float] = sample.steering_rad.tolist()
        if not (all(sample.valid) and math.isfinite(sum(angles) + sum(steering))):
            return
        self._last = (t_ns, angles, steering)
        if last is not None:
            possible = FASTEST_RAD_S * (t_ns - last[0]) / NS_PER_S + STEP_RAD
            if max([abs(a - b) for a, b in zip(angles, last[1], strict=True)]) > possible:
                self.clear()
            else:
                self._go(angles, steering, last[1], last[2])
        self.put(t_ns, self._now)

    def _go(
        self, angles: list[float], steering: list[float], before: list[float], steered: list[float]
    ) -> None:
        """Add the step between two sets of wheel and steering angles (4,)."""
        place, heading, rolled, contradiction = self._now
        step, turn, way, u = 0j, 0.0, 0.0, []
        for i, (radius, zero, along, across, turn_along, turn_across, _) in enumerate(self._wheels):
            length = (angles[i] - before[i]) * radius
            angle = 0.5 * (nearest_turn(steering[i], steered[i]) + steered[i]) - zero
            ahead, left = length * math.cos(angle), length * math.sin(angle)
            step += along * ahead + across * left
            turn += turn_along * ahead + turn_across * left
            way += abs(length)
            u.append(complex(ahead, left))
        worst = max([abs(u[i] - step - turn * wheel[6]) for i, wheel in enumerate(self._wheels)])
        middle = heading.real + 0.5 * turn
        self._now = (
            place + step * complex(math.cos(middle), math.sin(middle)),
            heading + turn,
            rolled + 0.25 * way,
            contradiction + worst,
        )


class GyroTrack(Track):
    """Integrates the angle about the surface normal, rad; a gap restarts the series."""

    def __init__(self) -> None:
        super().__init__()
        self._last: tuple[int, float, float] | None = None

    def reset(self) -> None:
        """Remove all values and the newest rate."""
        self.clear()
        self._last = None

    def take(self, sample: GyroMeasurement) -> None:
        """Add a sample."""
        t_ns, rate, last = sample.stamp.t_ns, sample.yaw_rate_rad_s, self._last
        if not math.isfinite(rate) or (last is not None and t_ns <= last[0]):
            return
        angle = 0.0
        if last is not None and t_ns - last[0] <= _GYRO_GAP_NS:
            angle = last[2] + 0.5 * (rate + last[1]) * (t_ns - last[0]) / NS_PER_S
        else:
            self.clear()
        self._last = (t_ns, rate, angle)
        self.put(t_ns, (angle,))
