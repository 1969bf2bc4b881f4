"""One set of outputs of the emulated BNO055: sensors, fusion and register counts, on flat vectors.

All numbers are in three vectors in SI units (magnetic field in uT), at the indices named below: the chip,
the offsets that remain after calibration, and the state of the fusion.
"""

import math

from hil.core.geometry import Array, Four, Three, multiplied
from hil.fakes.body_interface import BodyMotion
from hil.support.numba_jit import inner, kernel

inner(multiplied)

GRAVITY_M_S2 = 9.80665
_FIELD_X, _FIELD_Y, _FIELD_Z = 22.0, 0.0, -42.0
_MOST = 32767

# The chip (20,): rotation body to output axes (rows), output axes in the body (w, x, y, z), position of the
# chip, noise of its three sensors, time constant of the vertical, drift of the heading.
OUT_OF_BODY, OUT_IN_BODY, AT_X, AT_Y = 0, 9, 13, 14
ACCELEROMETER_NOISE, GYRO_NOISE, FIELD_NOISE, LEAKAGE, YAW_DRIFT = range(15, 20)
CHIP_SIZE = 20

# Offsets that remain after calibration (9,): accelerometer, gyroscope, magnetometer; output axes.
ACCELEROMETER, GYROSCOPE, MAGNETOMETER = 0, 3, 6
OFFSETS_SIZE = 9

# State (6,): leaked acceleration, error of the fused heading, last rate of turn, 1 if that rate is valid.
LEAK, YAW_ERROR, LAST_RATE, TURNED = 0, 3, 4, 5
STATE_SIZE = 6

DRAWS = 9
"""Random numbers per sample."""

Outputs = tuple[Three, Three, Three, Four, Three, Three]
Counts = tuple[
    int, int, int, int, int, int, int, int, int, int, int,
    int, int, int, int, int, int, int, int, int, int, int,
]  # fmt: skip


@kernel
def sense(
    motion: BodyMotion,
    dt: float,
    magnetometer: bool,
    draws: Array,
    row: int,
    offsets: Array,
    chip: Array,
    state: Array,
) -> Outputs:
    """Compute one sample of the sensors and of the fusion.

    Args:
        motion: motion of the body.
        dt: time since the last sample, s.
        magnetometer: True if the magnetometer is on; the field is 0 without it.
        draws: standard normal noise (n, 9).
        row: row of `draws` to use.
        offsets: (9,) remaining offsets.
        chip: (20,) constants of the chip.
        state: (6,) state of the fusion; updated.

    Returns:
        acceleration, rate, field, attitude w x y z, linear acceleration and gravity in output axes.
    """
    _, _, theta, _, _, w, a_x, a_y, tilt = motion
    noise = draws[row]
    s, c, st, ct = math.sin(theta), math.cos(theta), math.sin(tilt), math.cos(tilt)
    ux, uy, uz = turned(chip, st * c, -st * s, ct)
    alpha = (w - state[LAST_RATE]) / dt if state[TURNED] != 0.0 and dt > 0.0 else 0.0
    state[LAST_RATE], state[TURNED] = w, 1.0
    rx, ry = chip[AT_X], chip[AT_Y]
    kx, ky, kz = turned(chip, a_x - alpha * ry - w * w * rx, a_y + alpha * rx - w * w * ry, 0.0)
    g, o = GRAVITY_M_S2, offsets
    noisy = chip[ACCELEROMETER_NOISE]
    ax = kx + g * ux + o[ACCELEROMETER] + noisy * noise[0]
    ay = ky + g * uy + o[ACCELEROMETER + 1] + noisy * noise[1]
    az = kz + g * uz + o[ACCELEROMETER + 2] + noisy * noise[2]
    noisy = chip[GYRO_NOISE]
    rate = (
        chip[OUT_OF_BODY + 2] * w + 0.0 * ux + o[GYROSCOPE] + noisy * noise[3],
        chip[OUT_OF_BODY + 5] * w + 0.0 * uy + o[GYROSCOPE + 1] + noisy * noise[4],
        chip[OUT_OF_BODY + 8] * w + 0.0 * uz + o[GYROSCOPE + 2] + noisy * noise[5],
    )
    field = (0.0, 0.0, 0.0)
    if magnetometer:
        noisy, (bx, by, bz) = chip[FIELD_NOISE], magnetic_field(attitude(theta, tilt, 0.0, chip))
        field = (
            bx + 0.0 * ux + o[MAGNETOMETER] + noisy * noise[6],
            by + 0.0 * uy + o[MAGNETOMETER + 1] + noisy * noise[7],
            bz + 0.0 * uz + o[MAGNETOMETER + 2] + noisy * noise[8],
        )
    else:
        state[YAW_ERROR] += chip[YAW_DRIFT] * dt
    # The fusion: offset and leaked acceleration tilt its vertical.
    k = min(1.0, dt / chip[LEAKAGE])
    lx = state[LEAK] + k * (kx - state[LEAK])
    ly = state[LEAK + 1] + k * (ky - state[LEAK + 1])
    lz = state[LEAK + 2] + k * (kz - state[LEAK + 2])
    state[LEAK], state[LEAK + 1], state[LEAK + 2] = lx, ly, lz
    x = ux * g + o[ACCELEROMETER] + lx
    y = uy * g + o[ACCELEROMETER + 1] + ly
    z = uz * g + o[ACCELEROMETER + 2] + lz
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    x, y, z = x * scale, y * scale, z * scale
    tipped = (1.0, 0.5 * (y * uz - z * uy), 0.5 * (z * ux - x * uz), 0.5 * (x * uy - y * ux))
    qw, qx, qy, qz = multiplied(attitude(theta, tilt, state[YAW_ERROR], chip), tipped)
    n = 1.0 / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    gx, gy, gz = x * g, y * g, z * g
    fused = (qw * n, qx * n, qy * n, qz * n)
    return (ax, ay, az), rate, field, fused, (ax - gx, ay - gy, az - gz), (gx, gy, gz)


@inner
def turned(m: Array, x: float, y: float, z: float) -> Three:
    """Rotate a vector from body axes to the chip's output axes; m (20,) is the chip."""
    return (m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z)


@inner
def attitude(theta: float, tilt: float, yaw_error: float, chip: Array) -> Four:
    """Attitude of the output axes in earth axes, with this error of the heading; rad; chip (20,).

    Rotations: heading error, then tilt, then heading of the body.
    """
    yaw, half, turn = 0.5 * yaw_error, -0.5 * tilt, 0.5 * theta
    cy, sy, ch, sh = math.cos(yaw), math.sin(yaw), math.cos(half), math.sin(half)
    ct, st = math.cos(turn), math.sin(turn)
    w, x, y, z = cy * ch, -(sy * sh), cy * sh, sy * ch
    q = (w * ct - z * st, x * ct + y * st, y * ct - x * st, w * st + z * ct)
    return multiplied(
        q, (chip[OUT_IN_BODY], chip[OUT_IN_BODY + 1], chip[OUT_IN_BODY + 2], chip[OUT_IN_BODY + 3])
    )


@inner
def magnetic_field(q: Four) -> Three:
    """Earth's magnetic field in the axes of an attitude, uT."""
    w, x, y, z = q
    u, v, n = _FIELD_X, _FIELD_Y, _FIELD_Z
    return (
        (1 - 2 * (y * y + z * z)) * u + (2 * (x * y + w * z)) * v + (2 * (x * z - w * y)) * n,
        (2 * (x * y - w * z)) * u + (1 - 2 * (x * x + z * z)) * v + (2 * (y * z + w * x)) * n,
        (2 * (x * z + w * y)) * u + (2 * (y * z - w * x)) * v + (1 - 2 * (x * x + y * y)) * n,
    )


@kernel
def counts(outputs: Outputs, acc: float, gyro: float, field: float, angle: float, android: bool) -> Counts:
    """Register counts: acceleration, field, rate, Euler angles, quaternion, linear acceleration, gravity.

    Counts saturate at 16 bits.

    Args:
        outputs: result of `sense`.
        acc: counts per m/s^2.
        gyro: counts per rad/s.
        field: counts per uT.
        angle: counts per rad.
        android: sign convention of pitch.
    """
    (ax, ay, az), (rx, ry, rz), (bx, by, bz), q, (lx, ly, lz), (gx, gy, gz) = outputs
    heading, roll, pitch = euler_rad(q, android)
    return (
        whole(ax * acc), whole(ay * acc), whole(az * acc),
        whole(bx * field), whole(by * field), whole(bz * field),
        whole(rx * gyro), whole(ry * gyro), whole(rz * gyro),
        whole(heading * angle), whole(roll * angle), whole(pitch * angle),
        whole(q[0] * 16384), whole(q[1] * 16384), whole(q[2] * 16384), whole(q[3] * 16384),
        whole(lx * acc), whole(ly * acc), whole(lz * acc),
        whole(gx * acc), whole(gy * acc), whole(gz * acc),
    )  # fmt: skip


@inner
def euler_rad(q: Four, android: bool) -> Three:
    """Heading (0..2 pi, clockwise), roll and pitch as the chip defines them (datasheet 3.6.2, table 3-12)."""
    w, x, y, z = q
    heading = -math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) % (2 * math.pi)
    roll = -math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    pitch = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return heading, roll, pitch if android else -pitch


@inner
def whole(value: float) -> int:
    """Round to a 16-bit count and saturate."""
    if value > _MOST:
        return _MOST
    if value < -_MOST - 1:
        return -_MOST - 1
    return round(value)
