"""Encodes what the emulated BNO055 senses into its data registers 0x08..0x35, in the selected units."""

from __future__ import annotations

import math
import struct

from hil.fakes.imu.calibration import Vector
from hil.fakes.imu.registers import (
    UNIT_ANDROID,
    UNIT_EULER_RAD,
    UNIT_FAHRENHEIT,
    UNIT_MG,
    UNIT_RAD_S,
    Mode,
)
from hil.fakes.imu.sensors import GRAVITY_M_S2, Sensed
from hil.vocabulary.geometry import Four as Quaternion

_BLOCK = struct.Struct("<22hbB")
LENGTH = _BLOCK.size
EMPTY = bytes(LENGTH)
_ZERO = (0, 0, 0)
_MOST = 32767

ACC_LSB_PER_M_S2 = 100.0
GYRO_LSB_PER_RAD_S = 16.0 * 180.0 / math.pi
MAG_LSB_PER_UT = 16.0


def euler_rad(q: Quaternion, *, android: bool) -> Vector:
    """Heading (0..2 pi, clockwise), roll and pitch as the chip defines them (datasheet 3.6.2, table 3-12)."""
    w, x, y, z = q
    heading = -math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) % (2 * math.pi)
    roll = -math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    pitch = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return heading, roll, pitch if android else -pitch


def _counts(vector: Vector, scale: float) -> tuple[int, int, int]:
    x, y, z = vector
    return round(x * scale), round(y * scale), round(z * scale)


def _packed(counts: tuple[int, ...]) -> bytes:
    """The block; a count that does not fit stays at the end of its range."""
    try:
        return _BLOCK.pack(*counts)
    except struct.error:
        *counts_, temperature, calibration = counts
        return _BLOCK.pack(*(max(-_MOST - 1, min(_MOST, c)) for c in counts_), temperature, calibration)


def encode(sensed: Sensed, mode: Mode, units: int, calibration: int, celsius: float) -> bytes:
    """Register block 0x08..0x35; what the mode switches off reads zero."""
    acc = 1000.0 / GRAVITY_M_S2 if units & UNIT_MG else ACC_LSB_PER_M_S2
    gyro = 900.0 if units & UNIT_RAD_S else GYRO_LSB_PER_RAD_S
    temperature = round((celsius * 1.8 + 32.0) / 2.0 if units & UNIT_FAHRENHEIT else celsius)
    euler: tuple[int, ...] = _ZERO
    quaternion: tuple[int, ...] = (0, 0, 0, 0)
    linear = gravity = _ZERO
    if mode.fusion:
        w, x, y, z = sensed.quaternion
        quaternion = (round(w * 16384), round(x * 16384), round(y * 16384), round(z * 16384))
        degree = 900.0 if units & UNIT_EULER_RAD else 16.0 * 180.0 / math.pi
        euler = _counts(euler_rad(sensed.quaternion, android=bool(units & UNIT_ANDROID)), degree)
        linear, gravity = _counts(sensed.linear, acc), _counts(sensed.gravity, acc)
    return _packed(
        (
            *(_counts(sensed.acceleration, acc) if mode.accelerometer else _ZERO),
            *(_counts(sensed.field, MAG_LSB_PER_UT) if mode.magnetometer else _ZERO),
            *(_counts(sensed.rate, gyro) if mode.gyroscope else _ZERO),
            *euler,
            *quaternion,
            *linear,
            *gravity,
            temperature,
            calibration,
        )
    )
