"""The measurements of the emulated MicroStrain sensor, and the outputs of its filter.

Earth axes: z up, x along the horizontal direction that wall X leans to; they are the filter's north, west
and up, turned by its heading error. Without magnetometer the heading is 0 where the filter starts (3DM-CV7
user manual, "Filter Initialization"). Plain floats throughout: this runs up to a thousand times a second of
emulated time. All vectors that leave are in sensor axes, attitude is with respect to north, east, down.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hil.core.geometry import Four, Three, conjugated, multiplied, rotated, yaw_of_quat
from hil.fakes.body_interface import PlantState

GRAVITY_M_S2 = 9.80665
_UP_TO_NED = (0.0, 1.0, 0.0, 0.0)
_BLOCK, _NOISES = 1024, 6


@dataclass(frozen=True)
class MicrostrainTruthOptions:
    """True imperfections of one sensor; standard deviations of what is drawn from the world's seed.

    Noise as public logs of a 3DM-CV7-AHRS at rest show it, gravity as its filter reports it (WGS84 at the
    equator, until its position is set). Delays and times to start are assumptions.

    Attributes:
        position_m: sensor in the body, (3,).
        gyro_noise_rad_s, accelerometer_noise_m_s2: white noise per sample and axis.
        gyro_bias_rad_s, accelerometer_offset_m_s2: constant errors that the filter leaves, one sigma.
        heading_drift_rad_s: drift of the heading without magnetometer, one sigma.
        leakage_s: time constant with which accelerations reach the filter's vertical.
        filter_gravity_m_s2: length of gravity that the filter assumes.
        clock_ppm: error of the sensor's own clock.
        base_rate_hz: rate of its filter.
        processing_s: time from measurement to the first byte on the wire.
        answer_s: time from a command to the first byte of its answer.
        boot_s: time from power to the first answer.
        initialisation_s: time from there, or from a filter reset, to the first solution.
        mount_rotation_wxyz: sensor axes in the body as they truly are; as the bench configures them
            when None.
    """

    position_m: Three = (0.0655, 0.0, 0.098)
    gyro_noise_rad_s: float = 0.0026
    gyro_bias_rad_s: float = 0.0002
    accelerometer_noise_m_s2: float = 0.018
    accelerometer_offset_m_s2: float = 0.02
    heading_drift_rad_s: float = 1e-5
    leakage_s: float = 10.0
    filter_gravity_m_s2: float = 9.780325
    clock_ppm: float = 20.0
    base_rate_hz: int = 1000
    processing_s: float = 0.002
    answer_s: float = 0.002
    boot_s: float = 1.0
    initialisation_s: float = 0.5
    mount_rotation_wxyz: Four | None = None


@dataclass(frozen=True)
class Fused:
    """One set of filter outputs: (4,) sensor in north, east, down; (3,) in sensor axes, SI units."""

    quaternion: Four
    rate: Three
    linear: Three
    gravity: Three


class Sensing:
    """Accelerometer, gyroscope, and the filter over them.

    Args:
        options: true imperfections.
        rng: random generator of the sensor.
        mount_rotation_wxyz: sensor axes in the body.
    """

    def __init__(
        self, options: MicrostrainTruthOptions, rng: np.random.Generator, mount_rotation_wxyz: Four
    ) -> None:
        self._options, self._rng, self._mount = options, rng, mount_rotation_wxyz
        self._body_to_sensor = conjugated(mount_rotation_wxyz)
        self._noise: Iterator[list[float]] = iter(())
        self.gyro_bias: Three = _drawn(rng, options.gyro_bias_rad_s)
        self.accelerometer_offset: Three = _drawn(rng, options.accelerometer_offset_m_s2)
        self._drift_rad_s = float(rng.normal(0.0, options.heading_drift_rad_s))
        self.restart()

    def restart(self) -> None:
        """Restart the filter."""
        self._leak: Three = (0.0, 0.0, 0.0)
        self._last: tuple[int, float] | None = None
        self.heading_error_rad = 0.0

    def sense(self, truth: PlantState, *, relative: bool) -> Fused:
        """Filter outputs for the present true state.

        Args:
            truth: true state of the plant.
            relative: True if the heading is relative to that at the start of the filter, and drifts, as no
                magnetometer corrects it.
        """
        theta, tilt = float(truth.pose_body_in_wall[2]), truth.tilt_rad
        turn = float(truth.twist_body[2])
        if relative and self._last is None:
            start = multiplied(_UP_TO_NED, multiplied(_attitude(theta, tilt, 0.0), self._mount))
            self.heading_error_rad += yaw_of_quat(start)
        kinematic, dt_s = self._motion(truth, turn)
        if relative:
            self.heading_error_rad += self._drift_rad_s * dt_s
        sensor_in_earth = multiplied(_attitude(theta, tilt, self.heading_error_rad), self._mount)
        up = rotated(conjugated(sensor_in_earth), (0.0, 0.0, 1.0))
        noise, o = self._draw(), self._options
        specific_force = _sum(
            kinematic,
            _scaled(up, GRAVITY_M_S2),
            self.accelerometer_offset,
            _scaled(noise[:3], o.accelerometer_noise_m_s2),
        )
        spin = rotated(self._body_to_sensor, (0.0, 0.0, turn))
        rate = _sum(spin, self.gyro_bias, _scaled(noise[3:], o.gyro_noise_rad_s))
        seen_up = self._vertical(up, kinematic, dt_s)
        gravity = _scaled(seen_up, -o.filter_gravity_m_s2)
        attitude = multiplied(_UP_TO_NED, _tilted(sensor_in_earth, up, seen_up))
        return Fused(attitude, rate, _sum(specific_force, gravity), gravity)

    def _motion(self, truth: PlantState, turn: float) -> tuple[Three, float]:
        """Acceleration of the sensor, sensor axes, by origin + alpha x r + w x (w x r); and the time step."""
        last, self._last = self._last, (truth.t_ns, turn)
        dt_s = 0.0 if last is None else (truth.t_ns - last[0]) * 1e-9
        alpha = 0.0 if last is None or dt_s <= 0.0 else (turn - last[1]) / dt_s
        ax, ay = truth.acceleration_body.tolist()
        rx, ry, _ = self._options.position_m
        body = (ax - alpha * ry - turn * turn * rx, ay + alpha * rx - turn * turn * ry, 0.0)
        return rotated(self._body_to_sensor, body), dt_s

    def _vertical(self, up: Three, kinematic: Three, dt_s: float) -> Three:
        """The filter's vertical, unit length: off by the accelerometer's offset and leaked acceleration."""
        k = min(1.0, dt_s / self._options.leakage_s)
        leak = self._leak
        self._leak = _sum(leak, _scaled(_sum(kinematic, _scaled(leak, -1.0)), k))
        x, y, z = _sum(_scaled(up, GRAVITY_M_S2), self.accelerometer_offset, self._leak)
        return _scaled((x, y, z), 1.0 / math.sqrt(x * x + y * y + z * z))

    def _draw(self) -> list[float]:
        block = next(self._noise, None)
        if block is None:
            self._noise = iter(self._rng.standard_normal((_BLOCK, _NOISES)).tolist())
            block = next(self._noise)
        return block


def _attitude(theta: float, tilt: float, heading_error: float) -> Four:
    """Body in earth axes: lean by the tilt about Y, turn by theta about the surface's normal."""
    yaw, half = 0.5 * heading_error, -0.5 * tilt
    q = multiplied((math.cos(yaw), 0.0, 0.0, math.sin(yaw)), (math.cos(half), 0.0, math.sin(half), 0.0))
    return multiplied(q, (math.cos(0.5 * theta), 0.0, 0.0, math.sin(0.5 * theta)))


def _tilted(sensor_in_earth: Four, up: Three, seen_up: Three) -> Four:
    """The attitude whose vertical, in sensor axes, is `seen_up` instead of `up`; both of unit length."""
    ax, ay, az = seen_up
    bx, by, bz = up
    turn = (1.0 + ax * bx + ay * by + az * bz, ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
    q = multiplied(sensor_in_earth, turn)
    norm = math.sqrt(sum(v * v for v in q))
    return (q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)


def _drawn(rng: np.random.Generator, sigma: float) -> Three:
    x, y, z = rng.normal(0.0, sigma, 3).tolist()
    return (x, y, z)


def _sum(*vectors: Three) -> Three:
    xs, ys, zs = zip(*vectors, strict=True)
    return (sum(xs), sum(ys), sum(zs))


def _scaled(vector: Three | list[float], factor: float) -> Three:
    x, y, z = vector
    return (x * factor, y * factor, z * factor)
