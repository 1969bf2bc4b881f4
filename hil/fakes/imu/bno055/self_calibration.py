"""Self-calibration of the emulated BNO055: offset estimates and calibration status.

The gyroscope calibrates at rest, the accelerometer in several attitudes, the magnetometer in several
headings (datasheet 3.11); the four levels 0..3 are in register 0x35.
"""

from __future__ import annotations

Vector = tuple[float, float, float]

_GYRO_LEVEL_S = 0.5
_ATTITUDES_PER_LEVEL = 2
_RESTORED_ATTITUDES = 4
_MAX_LEVEL = 3


class SelfCalibration:
    """Offset estimates in chip axes: accelerometer m/s^2, gyroscope rad/s, magnetometer uT."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Reset offset estimates and calibration levels as after power-up."""
        self.accelerometer: list[float] = [0.0] * 3
        self.gyroscope: list[float] = [0.0] * 3
        self.magnetometer: list[float] = [0.0] * 3
        self.forget_levels()

    def forget_levels(self) -> None:
        """Reset the calibration levels and keep the offsets."""
        self._still_s = 0.0
        self._attitudes: set[tuple[int, int, int]] = set()
        self._headings: set[int] = set()
        self._restored = {"accelerometer": False, "gyroscope": False, "magnetometer": False}
        self._levels: tuple[int, int, int] | None = None

    def restore(self, sensor: str, values: Vector) -> None:
        """Set the offset estimate of a sensor, as restored by a client."""
        setattr(self, sensor, list(values))
        self._restored[sensor] = True
        self._levels = None

    def learn(self, still: bool, dt_s: float, up: Vector, heading_octant: int, truth: SensorOffsets) -> None:
        """Update the calibration after one fusion step; `up` is the unit vertical in sensor axes, (3,)."""
        if still:
            self._levels = None
            self._still_s += dt_s
            gain = min(1.0, dt_s / _GYRO_LEVEL_S)
            self.gyroscope = [
                g + gain * (b - g) for g, b in zip(self.gyroscope, truth.gyroscope, strict=True)
            ]
        x, y, z = up
        attitude = _side(x), _side(y), _side(z)
        if attitude not in self._attitudes:
            self._levels = None
            self._attitudes.add(attitude)
            if len(self._attitudes) > 1 and not self._restored["accelerometer"]:
                self.accelerometer = [
                    a + 0.5 * (b - a) for a, b in zip(self.accelerometer, truth.accelerometer, strict=True)
                ]
        if heading_octant not in self._headings:
            self._levels = None
            self._headings.add(heading_octant)
            if not self._restored["magnetometer"]:
                self.magnetometer = [
                    m + 0.5 * (b - m) for m, b in zip(self.magnetometer, truth.magnetometer, strict=True)
                ]

    def levels(self) -> tuple[int, int, int]:
        """Return the calibration levels (accelerometer, gyroscope, magnetometer), each 0..3."""
        if self._levels is None:
            self._levels = self._earned()
        return self._levels

    def _earned(self) -> tuple[int, int, int]:
        attitudes = len(self._attitudes) - 1 + _RESTORED_ATTITUDES * self._restored["accelerometer"]
        headings = len(self._headings) - 1 + _RESTORED_ATTITUDES * self._restored["magnetometer"]
        still_s = self._still_s + _GYRO_LEVEL_S * self._restored["gyroscope"]
        return (
            _level(attitudes / _ATTITUDES_PER_LEVEL),
            _level(still_s / _GYRO_LEVEL_S),
            _level(headings / _ATTITUDES_PER_LEVEL),
        )


def _side(along: float) -> int:
    """Return the sign of a vertical component, 0 if it is small."""
    return (1.4 * along > 0.5) - (1.4 * along < -0.5)


def _level(share: float) -> int:
    """Round a progress down to a level 0..3."""
    return 0 if share < 1.0 else _MAX_LEVEL if share >= _MAX_LEVEL else int(share)


class SensorOffsets:
    """True offsets in chip axes, same units as the estimates."""

    def __init__(self, accelerometer: Vector, gyroscope: Vector, magnetometer: Vector) -> None:
        self.accelerometer, self.gyroscope, self.magnetometer = accelerometer, gyroscope, magnetometer
