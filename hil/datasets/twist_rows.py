"""Twist of a body, of any drive train, as the rows of four wheels that would roll by it.

A twist says of the body's velocity what four wheels do that nowhere contradict each other: the wheel vectors
are u = P b, and pinv(P) u gives b back, whatever their places (`hil.robot.kinematics`). So the twist takes
the place of the forward kinematics, and everything behind it is the code for wheels. The places decide only
the lever at which the noise of the wheels becomes one of the turn.
"""

from pathlib import Path
from typing import Any

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array, Bools
from hil.robot.kinematics import WheelGeometry

_ABSENT = -1.0
_STILL_M_S, _STILL_SHARE = 1e-3, 0.02
"""A wheel slower than both, the latter as a share of the fastest, has no direction."""
_LATEST_S = 1.0


class TwistRows:
    """Collects the twists of `nav_msgs/Odometry`, `TwistWithCovarianceStamped` or `TwistStamped`.

    Covariances are not used, except that -1 marks a twist as unknown.
    """

    def __init__(self) -> None:
        self._rows: list[list[float]] = []

    def add(self, message: Any) -> None:
        """Add a message."""
        twist = getattr(message.twist, "twist", message.twist)
        spread = getattr(message.twist, "covariance", (0.0,))
        known = spread[0] != _ABSENT
        own = [twist.linear.x, twist.linear.y, twist.angular.z]
        self._rows.append(own if known else [np.nan] * 3)

    def rows(self, path: Path, topic: str, t_s: Array, geometry: WheelGeometry) -> tuple[Array, Array]:
        """Times (n,) of the rows, s, in order, and (n, 12): angles and steering, rad, and rates, rad/s.

        Args:
            path: bag, for messages.
            topic: topic of the messages.
            t_s: (m,) times of the messages, s, in the order in which they were added.
            geometry: places and radii of the wheels.

        Raises:
            DataError: the stamps step back, or no message holds a twist.
        """
        if float(np.max(np.maximum.accumulate(t_s) - t_s)) > _LATEST_S:
            raise DataError(
                str(path),
                f"the stamps of {topic} step back, and a twist is summed over time",
                expected="stamps that go on",
                remedy="cut the bag there",
            )
        order = np.argsort(t_s, kind="stable")
        times, twists = t_s[order], np.array(self._rows, dtype=np.float64)[order]
        known: Bools = np.all(np.isfinite(twists), axis=1)
        known[1:] &= np.diff(times) > 0.0
        if not known.any():
            raise DataError(
                str(path),
                f"{topic}: none of {len(known)} messages holds a twist",
                expected="numbers, and a covariance that is not -1",
            )
        return times[known], wheels_of_twist(times[known], twists[known], geometry)


def wheels_of_twist(t_s: Array, twist: Array, geometry: WheelGeometry) -> Array:
    """Rows (n, 12) of four wheels: cumulative angles and steering, rad, and rates, rad/s.

    A twist is the mean since the row before, as odometry publishes it: noise of rows then stays independent,
    as the filters expect. Steering is the direction in which a wheel's place
    moves, forwards or backwards, whichever is nearer to that of the row before; where it hardly moves the
    module turns evenly to where it goes next.

    Args:
        t_s: (n,) times, s, increasing.
        twist: (n, 3) m/s, m/s, rad/s, body frame.
        geometry: places and radii of the wheels.
    """
    vectors = twist @ geometry.projection().T
    ahead, left = vectors[:, 0::2], vectors[:, 1::2]
    since = _directions(t_s, ahead, left)
    steering = 0.5 * (since + np.vstack([since[1:], since[-1:]]))
    middle = 0.5 * (steering + np.vstack([steering[:1], steering[:-1]]))
    rate = (ahead * np.cos(middle) + left * np.sin(middle)) / geometry.radius_m
    rolled = rate * np.diff(t_s, prepend=t_s[0])[:, None]
    angle = np.cumsum(rolled, axis=0)
    return np.column_stack([angle, steering + geometry.steering_zero_rad, rate])


def _directions(t_s: Array, ahead: Array, left: Array) -> Array:
    """Directions (n, 4) of wheels, rad, from velocities (n, 4), m/s; without leaps."""
    speed = np.hypot(ahead, left)
    moves: Bools = speed > np.maximum(_STILL_M_S, _STILL_SHARE * speed.max(axis=1, keepdims=True))
    out = np.zeros_like(ahead)
    for i in range(ahead.shape[1]):
        rows = np.flatnonzero(moves[:, i])
        if len(rows):
            axis = np.unwrap(np.arctan2(left[rows, i], ahead[rows, i]), period=np.pi)
            axis -= np.pi * np.round(np.median(axis) / np.pi)
            out[:, i] = np.interp(t_s, t_s[rows], axis)
    return out
