"""Sensors and fusion of the emulated BNO055, from the motion of the body.

Earth axes: z up, x along the horizontal direction that wall X leans to. A tilt of `tau` turns the
wall frame about its Y axis, so on a vertical wall (tau = pi/2) gravity lies in the motion plane.
`output_sample` computes each sample; this module has what changes rarely, and the calibration.
"""

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hil.core.geometry import Four as Quaternion
from hil.core.geometry import yaw_of_quat
from hil.fakes.body_interface import BodyMotion
from hil.fakes.imu.bno055 import output_sample
from hil.fakes.imu.bno055.registers import Mode
from hil.fakes.imu.bno055.self_calibration import SelfCalibration, SensorOffsets, Vector
from hil.support.numba_jit import compile_for, plain

_BLOCK = 1024
_STILL_RATE_RAD_S = 0.003
_STILL_SPEED_M_S = 0.001
_UPSIDE_DOWN = 1e-6

Matrix = tuple[Vector, Vector, Vector]


@dataclass(frozen=True)
class ImuTruthOptions:
    """True imperfections of one chip; standard deviations of what is drawn from the world's seed.

    The accelerometer offset of a real part is up to 80 mg uncalibrated (datasheet); a bench that has
    been calibrated once has a tenth of that.

    Attributes:
        position_m: chip in the body, (3,).
        gyro_noise_rad_s, accelerometer_noise_m_s2, magnetometer_noise_ut: white noise per sample and axis.
        gyro_dead_zone_rad_s: rate below which an axis reports 0 while the fusion runs; 3 deg/s where it
            shows nothing slower.
        gyro_bias_rad_s, accelerometer_offset_m_s2, magnetometer_offset_ut: constant errors, one sigma.
        yaw_drift_rad_s: drift of the fused heading without magnetometer, one sigma.
        leakage_s: time constant with which accelerations reach the fused vertical.
        clock_ppm: error of the chip's own 100 Hz.
        mount_rotation_wxyz: sensor axes in the body as they truly are; as the bench configures them
            when None.
    """

    position_m: Vector = (0.0655, 0.0, 0.098)
    gyro_noise_rad_s: float = 0.0017
    gyro_dead_zone_rad_s: float = 0.0
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
    """One set of outputs in sensor (remapped) axes, SI units, magnetic field in uT (0 when off)."""

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
    return (a[0] * x + a[1] * y + a[2] * z, b[0] * x + b[1] * y + b[2] * z, c[0] * x + c[1] * y + c[2] * z)


def transpose(m: Matrix) -> Matrix:
    """Transposed matrix."""
    return (m[0][0], m[1][0], m[2][0]), (m[0][1], m[1][1], m[2][1]), (m[0][2], m[1][2], m[2][2])


def product(a: Matrix, b: Matrix) -> Matrix:
    """Matrix product."""
    columns = [apply(a, column) for column in transpose(b)]
    return transpose((columns[0], columns[1], columns[2]))


def names_each_axis(axis_map: int) -> bool:
    """Return whether an axis map is valid; the chip ignores any other (datasheet 3.4)."""
    return sorted((axis_map >> shift) & 3 for shift in (0, 2, 4)) == [0, 1, 2]


def remap(axis_map: int, axis_sign: int) -> Matrix:
    """Signed permutation from chip axes to sensor axes, by registers 0x41 and 0x42 (datasheet 3.4)."""
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
        self._draws, self._row = np.zeros((1, output_sample.DRAWS)), 0
        spread = (options.accelerometer_offset_m_s2, options.gyro_bias_rad_s, options.magnetometer_offset_ut)
        drawn = [tuple(float(x) for x in rng.normal(0.0, s, 3)) for s in spread]
        self.true_offsets = SensorOffsets(*drawn)  # type: ignore[arg-type]
        yaw_drift_rad_s = float(rng.normal(0.0, options.yaw_drift_rad_s))
        self._chip_in_body = chip_in_body
        self._chip, self._state = np.zeros(output_sample.CHIP_SIZE), np.zeros(output_sample.STATE_SIZE)
        for at, value in (
            (output_sample.AT_X, options.position_m[0]),
            (output_sample.AT_Y, options.position_m[1]),
            (output_sample.ACCELEROMETER_NOISE, options.accelerometer_noise_m_s2),
            (output_sample.GYRO_NOISE, options.gyro_noise_rad_s),
            (output_sample.FIELD_NOISE, options.magnetometer_noise_ut),
            (output_sample.LEAKAGE, options.leakage_s),
            (output_sample.YAW_DRIFT, yaw_drift_rad_s),
        ):
            self._chip[at] = value
        self._offsets = np.zeros(output_sample.OFFSETS_SIZE)
        self._offsets_of: tuple[object, ...] = (None,) * 4
        compile_for(
            output_sample.sense,
            (0.0,) * 9,
            0.0,
            False,
            self._draws,
            0,
            self._offsets,
            self._chip,
            self._state,
        )
        three = (0.0, 0.0, 0.0)
        sensed = Sensed(three, three, three, (1.0, 0.0, 0.0, 0.0), three, three)
        compile_for(output_sample.counts, plain(sensed), *[0.0] * 4, False)
        self.set_remap(0x24, 0x00)
        self.restart_fusion()

    @property
    def yaw_error_rad(self) -> float:
        """Fused heading minus the true one, rad."""
        return float(self._state[output_sample.YAW_ERROR])

    def turn(self, angle_rad: float) -> None:
        """Add a step to the fused heading."""
        self._state[output_sample.YAW_ERROR] += angle_rad

    def set_remap(self, axis_map: int, axis_sign: int) -> None:
        """Set the axes from the remap registers; the map must be valid."""
        self._remap = remap(axis_map, axis_sign)
        out_in_body = product(self._chip_in_body, transpose(self._remap))
        self._out_of_body = transpose(out_in_body)
        rotation = (*itertools.chain.from_iterable(self._out_of_body), *quaternion_of(out_in_body))
        for at, value in enumerate(rotation, output_sample.OUT_OF_BODY):
            self._chip[at] = value

    def restart_fusion(self) -> None:
        """Restart the fusion: clear leaked acceleration, last rate and heading."""
        self._starting = True
        for at in (
            output_sample.LEAK,
            output_sample.LEAK + 1,
            output_sample.LEAK + 2,
            output_sample.LAST_RATE,
            output_sample.TURNED,
        ):
            self._state[at] = 0.0

    def sense(self, body: BodyMotion, mode: Mode, dt_s: float) -> Sensed:
        """Return the sensor outputs for the present motion of the body, `dt_s` after the previous call."""
        if mode.fusion:
            self._learn(body, dt_s)
            if self._starting:
                self._start_heading(body, mode)
        self._leave_offsets()
        if not self._row:
            self._draws, self._row = self._rng.standard_normal((_BLOCK, output_sample.DRAWS)), _BLOCK
        outputs = output_sample.sense(
            plain(body),
            dt_s,
            mode.magnetometer,
            self._draws,
            _BLOCK - self._row,
            self._offsets,
            self._chip,
            self._state,
        )
        self._row -= 1
        sensed, zone = Sensed(*outputs), self.options.gyro_dead_zone_rad_s
        if not (zone and mode.fusion):
            return sensed
        x, y, z = (rate if abs(rate) >= zone else 0.0 for rate in sensed.rate)
        return sensed._replace(rate=(x, y, z))

    def _start_heading(self, body: BodyMotion, mode: Mode) -> None:
        """Set the heading at the start of the fusion: 0, or the true one in absolute modes.

        The heading is the rotation about the vertical (twist). A sensor upside down has none.
        """
        self._starting = False
        q = output_sample.attitude(body.theta_rad, body.tilt_rad, 0.0, self._chip)
        has_heading = math.hypot(q[0], q[3]) > _UPSIDE_DOWN
        relative = has_heading and not mode.absolute
        self._state[output_sample.YAW_ERROR] = -yaw_of_quat(q) if relative else 0.0

    def _learn(self, body: BodyMotion, dt_s: float) -> None:
        """Calibrate from the present attitude and motion."""
        _, _, theta, vx, vy, w, _, _, tilt = body
        s, c, st, ct = math.sin(theta), math.cos(theta), math.sin(tilt), math.cos(tilt)
        still = abs(w) < _STILL_RATE_RAD_S and abs(vx) + abs(vy) < _STILL_SPEED_M_S
        up, octant = apply(self._out_of_body, (st * c, -st * s, ct)), math.floor(theta * 4.0 / math.pi) % 8
        self.calibration.learn(still, dt_s, up, octant, self.true_offsets)

    def _leave_offsets(self) -> None:
        """Update the remaining offsets in output axes, if estimates or axes have changed."""
        known, true, before = self.calibration, self.true_offsets, self._offsets_of
        now = (known.accelerometer, known.gyroscope, known.magnetometer, self._remap)
        if now[0] is before[0] and now[1] is before[1] and now[2] is before[2] and now[3] is before[3]:
            return
        self._offsets_of = now
        for at, t, k in (
            (output_sample.ACCELEROMETER, true.accelerometer, known.accelerometer),
            (output_sample.GYROSCOPE, true.gyroscope, known.gyroscope),
            (output_sample.MAGNETOMETER, true.magnetometer, known.magnetometer),
        ):
            left = apply(self._remap, (t[0] - k[0], t[1] - k[1], t[2] - k[2]))
            self._offsets[at], self._offsets[at + 1], self._offsets[at + 2] = left
