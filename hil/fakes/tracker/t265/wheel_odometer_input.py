"""Wheel odometer of the camera: its calibration, and the check and use of velocities.

The T265 accepts up to two velocity sensors. Each has a position and a rotation vector in the camera's axes,
and a variance of its velocities (librealsense's manual of the T265).
"""

import json
import math
from typing import Any, NamedTuple

import numpy as np

from hil.core.clock import nanoseconds
from hil.core.geometry import Array, quat_from_rotvec, quat_rotate

_MOST_SENSORS = 2
_FASTEST_M_S = 10.0
_FRESH_NS = nanoseconds(0.1)
_VISUAL_VARIANCE = 1e-4
"""Variance of the camera's own velocity, (m/s)^2, which sets its weight relative to the wheels."""


class VelocitySensor(NamedTuple):
    """One sensor: position (m) and rotation in the camera's axes, scale (3, 3), variance (m/s)^2."""

    place_m: Array
    rotation_wxyz: Array
    scale: Array
    variance: float


class WheelInput:
    """Velocity measurements by the wheels that one camera has received.

    Attributes:
        taken, refused: number of accepted and rejected velocities.
    """

    def __init__(self) -> None:
        self._sensors: tuple[VelocitySensor, ...] = ()
        self._last: dict[int, tuple[int, int, Array]] = {}
        self.taken = self.refused = 0

    def load(self, text: bytes) -> bool:
        """Load a calibration; returns whether it is valid."""
        try:
            found = json.loads(text)
            sensors = tuple(_sensor(one) for one in found["velocimeters"])
        except (ValueError, KeyError, TypeError):
            return False
        if not 1 <= len(sensors) <= _MOST_SENSORS:
            return False
        self._sensors, self._last = sensors, {}
        return True

    def send(self, sensor: int, number: int, velocity_m_s: tuple[float, float, float], t_ns: int) -> bool:
        """Store a velocity in the axes of its sensor; returns whether it is valid."""
        last = self._last.get(sensor)
        fits = 0 <= sensor < len(self._sensors) and (last is None or number > last[0])
        if not (fits and all(map(math.isfinite, velocity_m_s)) and math.hypot(*velocity_m_s) <= _FASTEST_M_S):
            self.refused += 1
            return False
        self._last[sensor] = number, t_ns, np.array(velocity_m_s)
        self.taken += 1
        return True

    def velocity(self, t_ns: int, rate_rad_s: Array) -> tuple[Array, float] | None:
        """Velocity of the camera in its own axes (3,), m/s, and its weight relative to the visual velocity.

        Args:
            t_ns: world time.
            rate_rad_s: rate of turn of the camera in its axes (3,).
        """
        fresh = [(k, v) for k, (_, at_ns, v) in self._last.items() if t_ns - at_ns <= _FRESH_NS]
        if not fresh:
            return None
        seen = []
        for k, velocity in fresh:
            sensor = self._sensors[k]
            at_sensor = quat_rotate(sensor.rotation_wxyz, sensor.scale @ velocity)
            seen.append(at_sensor - np.cross(rate_rad_s, sensor.place_m))
        variance = max(self._sensors[k].variance for k, _ in fresh) / len(fresh)
        return np.mean(seen, axis=0), _VISUAL_VARIANCE / (_VISUAL_VARIANCE + variance)


def _sensor(given: Any) -> VelocitySensor:
    """Decode a sensor of a calibration; raises `ValueError`, `KeyError` or `TypeError`."""
    extrinsics = given["extrinsics"]
    place_m, turn_rad = (np.array(extrinsics[key], dtype=np.float64).reshape(3) for key in ("T", "W"))
    scale = np.array(given["scale_and_alignment"], dtype=np.float64).reshape(3, 3)
    variance = float(given["noise_variance"])
    if not (variance > 0.0 and np.isfinite([*place_m, *turn_rad, *scale.ravel(), variance]).all()):
        raise ValueError("a calibration holds finite numbers and a positive variance")
    return VelocitySensor(place_m, quat_from_rotvec(turn_rad), scale, variance)
