"""What the sensors inside the emulated BNO055 see of the world, and what its fusion makes of it.

Earth axes: z up, x along the horizontal direction that wall X leans to. A tilt of `tau` turns the
wall frame about its Y axis, so on a vertical wall (tau = pi/2) gravity lies in the motion plane.
Plain floats throughout: this runs a hundred times a second of emulated time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hil.fakes.imu.calibration import SelfCalibration, SensorOffsets, Vector
from hil.fakes.imu.registers import Mode
from hil.fakes.plant_api import BodyMotion
from hil.vocabulary.geometry import Four as Quaternion
from hil.vocabulary.geometry import multiplied

GRAVITY_M_S2 = 9.80665
_FIELD_UT = (22.0, 0.0, -42.0)
_BLOCK = 1024
_NOTHING = (0.0, 0.0, 0.0)
_STILL_RATE_RAD_S = 0.003
_STILL_SPEED_M_S = 0.001

Matrix = tuple[Vector, Vector, Vector]


@dataclass(frozen=True)
class ImuTruthOptions:
    """True imperfections of one chip; standard deviations of what is drawn from the world's seed.

    The accelerometer offset of a real part is up to 80 mg uncalibrated (datasheet); a bench that has
    been calibrated once has a tenth of that.

    Attributes:
        position_m: chip in the body, (3,).
        gyro_noise_rad_s, accelerometer_noise_m_s2, magnetometer_noise_ut: white noise per sample and axis.
        gyro_bias_rad_s, accelerometer_offset_m_s2, magnetometer_offset_ut: constant errors, one sigma.
        yaw_drift_rad_s: drift of the fused heading without magnetometer, one sigma.
        leakage_s: time constant with which accelerations reach the fused vertical.
        clock_ppm: error of the chip's own 100 Hz.
        mount_rotation_wxyz: sensor axes in the body as they truly are; as the bench configures them
            when None.
    """

    position_m: Vector = (0.0655, 0.0, 0.098)
    gyro_noise_rad_s: float = 0.0017
    gyro_bias_rad_s: float = 0.003
    accelerometer_noise_m_s2: float = 0.02
    accelerometer_offset_m_s2: float = 0.05
    magnetometer_noise_ut: float = 0.5
    magnetometer_offset_ut: float = 8.0
    yaw_drift_rad_s: float = 2e-5
    leakage_s: float = 3.0
    clock_ppm: float = 50.0
    mount_rotation_wxyz: Quaternion | None = None


class Sensed(NamedTuple):
    """One set of outputs in sensor (remapped) axes, SI units, magnetic field in uT (0 where it is off)."""

    acceleration: Vector
    rate: Vector
    field: Vector
    quaternion: Quaternion
    linear: Vector
    gravity: Vector


def matrix(q: Quaternion) -> Matrix:
    """Rotation matrix of a unit quaternion, rows."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def apply(m: Matrix, v: Vector) -> Vector:
    """Matrix times vector."""
    x, y, z = v
    a, b, c = m
    return (
        a[0] * x + a[1] * y + a[2] * z,
        b[0] * x + b[1] * y + b[2] * z,
        c[0] * x + c[1] * y + c[2] * z,
    )


def transpose(m: Matrix) -> Matrix:
    """Transposed matrix."""
    return (m[0][0], m[1][0], m[2][0]), (m[0][1], m[1][1], m[2][1]), (m[0][2], m[1][2], m[2][2])


def product(a: Matrix, b: Matrix) -> Matrix:
    """Matrix product."""
    columns = [apply(a, column) for column in transpose(b)]
    return transpose((columns[0], columns[1], columns[2]))


def remap(axis_map: int, axis_sign: int) -> Matrix:
    """Signed permutation of registers 0x41 and 0x42: sensor axes from chip axes (datasheet 3.4)."""
    rows: list[Vector] = []
    for index, sign_bit in enumerate((4, 2, 1)):
        row = [0.0, 0.0, 0.0]
        row[(axis_map >> 2 * index) & 3] = -1.0 if axis_sign & sign_bit else 1.0
        rows.append((row[0], row[1], row[2]))
    return rows[0], rows[1], rows[2]


def quaternion_of(m: Matrix) -> Quaternion:
    """Unit quaternion of a rotation matrix (largest component first, Shepperd's method)."""
    (a, b, c), (d, e, f), (g, h, i) = m
    squares = (1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i)
    k = max(range(4), key=squares.__getitem__)
    s = 2 * math.sqrt(max(squares[k], 1e-12))
    rows: tuple[Quaternion, ...] = (
        (s / 4, (h - f) / s, (c - g) / s, (d - b) / s),
        ((h - f) / s, s / 4, (b + d) / s, (c + g) / s),
        ((c - g) / s, (b + d) / s, s / 4, (f + h) / s),
        ((d - b) / s, (c + g) / s, (f + h) / s, s / 4),
    )
    return rows[k]


class InertialSensors:
    """Accelerometer, gyroscope, magnetometer and the fusion over them."""

    def __init__(self, options: ImuTruthOptions, rng: np.random.Generator, *, chip_in_body: Matrix) -> None:
        self.options = options
        self.calibration = SelfCalibration()
        self._rng = rng
        self._noise: Iterator[list[float]] = iter(())
        spread = (
            options.accelerometer_offset_m_s2,
            options.gyro_bias_rad_s,
            options.magnetometer_offset_ut,
        )
        drawn = [tuple(float(x) for x in rng.normal(0.0, s, 3)) for s in spread]
        self.true_offsets = SensorOffsets(*drawn)  # type: ignore[arg-type]
        self._yaw_drift_rad_s = float(rng.normal(0.0, options.yaw_drift_rad_s))
        self.yaw_error_rad = 0.0
        self._chip_in_body = chip_in_body
        self._residual_of: tuple[object, ...] = (None,) * 4
        self._residual: tuple[Vector, Vector, Vector] = (_NOTHING,) * 3
        self.set_remap(0x24, 0x00)
        self.restart_fusion()

    def set_remap(self, axis_map: int, axis_sign: int) -> None:
        """Take over the axis registers; a map that names an axis twice is ignored, as on the chip."""
        if sorted((axis_map >> shift) & 3 for shift in (0, 2, 4)) != [0, 1, 2]:
            return
        self._remap = remap(axis_map, axis_sign)
        out_in_body = product(self._chip_in_body, transpose(self._remap))
        self._body_to_out = transpose(out_in_body)
        self._out_in_body = quaternion_of(out_in_body)

    def restart_fusion(self) -> None:
        """The fusion starts anew: heading zero where it stands now, leaked acceleration forgotten."""
        self._leak: Vector = (0.0, 0.0, 0.0)
        self._last_rate: float | None = None

    def sense(self, body: BodyMotion, mode: Mode, dt_s: float) -> Sensed:
        """Sensor outputs for the present motion of the body, `dt_s` after the previous call."""
        _, _, theta, vx, vy, w, _, _, tilt = body
        s, c, st, ct = math.sin(theta), math.cos(theta), math.sin(tilt), math.cos(tilt)
        noise = self._draw()
        up = apply(self._body_to_out, (st * c, -st * s, ct))
        kinematic = apply(self._body_to_out, self._acceleration(body, dt_s))
        (_, _, ax), (_, _, ay), (_, _, az) = self._body_to_out
        spin = ax * w, ay * w, az * w
        still = abs(w) < _STILL_RATE_RAD_S and abs(vx) + abs(vy) < _STILL_SPEED_M_S
        if mode.fusion:
            octant = math.floor(theta * 4.0 / math.pi) % 8
            self.calibration.learn(
                still=still, dt_s=dt_s, up=up, heading_octant=octant, truth=self.true_offsets
            )
        acc_rest, gyro_rest, mag_rest = self._residual_offsets()
        o, g = self.options, GRAVITY_M_S2
        acceleration = _blend(kinematic, up, g, acc_rest, noise[0:3], o.accelerometer_noise_m_s2)
        rate = _blend(spin, up, 0.0, gyro_rest, noise[3:6], o.gyro_noise_rad_s)
        quaternion = self._attitude(theta, tilt)
        field = _NOTHING
        if mode.magnetometer:
            turn = transpose(matrix(quaternion))
            field = _blend(apply(turn, _FIELD_UT), up, 0.0, mag_rest, noise[6:9], o.magnetometer_noise_ut)
        gravity, attitude = self._fuse(quaternion, up, kinematic, acc_rest, dt_s)
        linear = (acceleration[0] - gravity[0], acceleration[1] - gravity[1], acceleration[2] - gravity[2])
        return Sensed(acceleration, rate, field, attitude, linear, gravity)

    def _draw(self) -> list[float]:
        block = next(self._noise, None)
        if block is None:
            self._noise = iter(self._rng.standard_normal((_BLOCK, 9)).tolist())
            block = next(self._noise)
        return block

    def _acceleration(self, body: BodyMotion, dt_s: float) -> Vector:
        """Kinematic acceleration of the chip in body axes: origin + alpha x r + w x (w x r)."""
        w, ax, ay = body.omega_rad_s, body.a_x_m_s2, body.a_y_m_s2
        rx, ry, _ = self.options.position_m
        alpha = 0.0 if self._last_rate is None or dt_s <= 0 else (w - self._last_rate) / dt_s
        self._last_rate = w
        return (ax - alpha * ry - w * w * rx, ay + alpha * rx - w * w * ry, 0.0)

    def _residual_offsets(self) -> tuple[Vector, Vector, Vector]:
        """What calibration has left of the offsets, output axes; worked out when it has learnt something."""
        known, true = self.calibration, self.true_offsets
        now = (known.accelerometer, known.gyroscope, known.magnetometer, self._remap)
        if any(a is not b for a, b in zip(now, self._residual_of, strict=True)):
            pairs = (
                (true.accelerometer, known.accelerometer),
                (true.gyroscope, known.gyroscope),
                (true.magnetometer, known.magnetometer),
            )
            a, b, c = (apply(self._remap, (t[0] - k[0], t[1] - k[1], t[2] - k[2])) for t, k in pairs)
            self._residual_of, self._residual = now, (a, b, c)
        return self._residual

    def _attitude(self, theta: float, tilt: float) -> Quaternion:
        """Attitude that the fusion would know without leaks: turned by its error, tilted, by its heading."""
        yaw, half, turn = 0.5 * self.yaw_error_rad, -0.5 * tilt, 0.5 * theta
        cy, sy, ch, sh = math.cos(yaw), math.sin(yaw), math.cos(half), math.sin(half)
        ct, st = math.cos(turn), math.sin(turn)
        w, x, y, z = cy * ch, -(sy * sh), cy * sh, sy * ch
        q = (w * ct - z * st, x * ct + y * st, y * ct - x * st, w * st + z * ct)
        return multiplied(q, self._out_in_body)

    def _fuse(
        self, q: Quaternion, up: Vector, kinematic: Vector, offset: Vector, dt_s: float
    ) -> tuple[Vector, Quaternion]:
        """Fused gravity and attitude: the vertical is off by the offset and by leaked acceleration."""
        self.yaw_error_rad += self._yaw_drift_rad_s * dt_s
        k = min(1.0, dt_s / self.options.leakage_s)
        lx, ly, lz = self._leak
        lx, ly, lz = lx + k * (kinematic[0] - lx), ly + k * (kinematic[1] - ly), lz + k * (kinematic[2] - lz)
        self._leak = (lx, ly, lz)
        g = GRAVITY_M_S2
        x, y, z = up[0] * g + offset[0] + lx, up[1] * g + offset[1] + ly, up[2] * g + offset[2] + lz
        scale = 1.0 / math.sqrt(x * x + y * y + z * z)
        x, y, z = x * scale, y * scale, z * scale
        half_x = 0.5 * (y * up[2] - z * up[1])
        half_y = 0.5 * (z * up[0] - x * up[2])
        half_z = 0.5 * (x * up[1] - y * up[0])
        w, qx, qy, qz = multiplied(q, (1.0, half_x, half_y, half_z))
        n = 1.0 / math.sqrt(w * w + qx * qx + qy * qy + qz * qz)
        return (x * g, y * g, z * g), (w * n, qx * n, qy * n, qz * n)


def _blend(value: Vector, up: Vector, g: float, offset: Vector, noise: list[float], sigma: float) -> Vector:
    return (
        value[0] + g * up[0] + offset[0] + sigma * noise[0],
        value[1] + g * up[1] + offset[1] + sigma * noise[1],
        value[2] + g * up[2] + offset[2] + sigma * noise[2],
    )
