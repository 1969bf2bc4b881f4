"""Which parameter of the bench file a lasting difference of two sensors would mean.

A sensor that sees every step from the start of a motion too long by one factor, or turned by one angle, has a
wrong scale or mount. One that is frozen, that jumps, or that begins to differ later has not.
"""

import cmath
import math
from typing import NamedTuple

_SAME, _TURNED_RAD, _LARGEST = 0.06, 0.12, 3.0
"""Ratio and angle that good sensors may have; beyond the last ratio a sensor is frozen or broken."""
_OF_SCALE = {"servos": ("robot.wheel_radius_m", -1), "tracker": ("tracker.scale", 1)}
"""By sensor: the key that scales its steps, and whether a longer step means a larger value."""
_OF_AXES = {
    "servos": "alignment.steer_zero_rad",
    "tracker": "tracker.mount_rotation_wxyz",
    "mocap": "mocap.body",
}
_OF_DIRECTION = {**_OF_AXES, "servos": "alignment.drive_sign"}
_OF_TURNS = {
    "servos": "robot.wheel_x_m, robot.wheel_y_m",
    "tracker": "tracker.mount_rotation_wxyz",
    "imu": "imu.mount_rotation_wxyz",
}
_MIRRORED = {**_OF_TURNS, "servos": "servos.drive_ids, robot.wheel_x_m, robot.wheel_y_m"}


_OF_DELAY = {"tracker": "tracker.latency_s", "mocap": "mocap.transit_s"}
_OF_LEVER = {"tracker": "tracker.mount_position_m", "mocap": "mocap.body"}
_LEVERS_M = (0.03, 0.5)
"""Places on the body that a robot's sensors can be wrong by, and that are known no better."""


class Explanation(NamedTuple):
    """A parameter that would explain a difference.

    Attributes:
        key: its keys in the bench file, separated by commas.
        text: description of what is wrong with it.
        factor: factor by which its value would fit; 0 for none.
    """

    key: str
    text: str
    factor: float = 0.0


def explained(source: str, ratio: complex, *, turns: bool) -> Explanation | None:
    """The parameter of a sensor that would explain its steps; None where none would.

    Args:
        source: the sensor.
        ratio: its displacement over that of another, in the body's axes, or its turn over the other's.
        turns: True if they are turns.
    """
    size = abs(ratio)
    if not 1.0 / _LARGEST < size < _LARGEST:
        if turns and source == "imu" and size <= 1.0 / _LARGEST:
            return Explanation(_OF_TURNS[source], "which turns its axis of rotation")
        return None
    if turns:
        key = (_MIRRORED if ratio.real < 0.0 else _OF_TURNS).get(source, "")
        return Explanation(key, f"which makes turns {ratio.real:.2f} times as large") if key else None
    angle_rad = cmath.phase(ratio)
    if abs(angle_rad) <= _TURNED_RAD:
        key, power = _OF_SCALE.get(source, ("", 0))
        if not key or abs(math.log(size)) <= _SAME:
            return None
        factor = size**power
        return Explanation(key, f"{factor:.3f} times its value would fit", factor)
    opposite = abs(abs(angle_rad) - math.pi) <= _TURNED_RAD
    key = (_OF_DIRECTION if opposite else _OF_AXES).get(source, "")
    return Explanation(key, f"which turns it by {math.degrees(angle_rad):+.0f} deg") if key else None


def explained_by_delay(source: str) -> Explanation | None:
    """The delay of a sensor whose difference grows with the speed, not with the way; None for none."""
    key = _OF_DELAY.get(source, "")
    return (
        Explanation(key, "which moves its steps in time: the difference grows with the speed")
        if key
        else None
    )


def explained_by_lever(source: str, lever_m: float) -> Explanation | None:
    """The place of a sensor on the body that would explain how it moves in a turn; None for none.

    Args:
        source: the sensor.
        lever_m: difference of the displacements over the turn, m per rad.
    """
    key = _OF_LEVER.get(source, "")
    if not key or not _LEVERS_M[0] < lever_m < _LEVERS_M[1]:
        return None
    return Explanation(key, f"which is {1e3 * lever_m:.0f} mm off")
