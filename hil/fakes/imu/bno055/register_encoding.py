"""Registers of the emulated BNO055: data 0x08..0x35 in the selected units, calibration bytes 0x55..0x6A.

One count of an offset is 0.01 m/s^2, 1/16 degree/s, 1/16 uT. The offsets of a sensor take effect when their
last byte is written.
"""

import math
import struct

from hil.fakes.imu.bno055 import registers as reg
from hil.fakes.imu.bno055.output_sample import GRAVITY_M_S2, counts
from hil.fakes.imu.bno055.registers import (
    UNIT_ANDROID,
    UNIT_EULER_RAD,
    UNIT_FAHRENHEIT,
    UNIT_MG,
    UNIT_RAD_S,
    Mode,
)
from hil.fakes.imu.bno055.self_calibration import SelfCalibration
from hil.fakes.imu.bno055.sensor_physics import Sensed
from hil.support.numba_jit import plain

_BLOCK = struct.Struct("<22hbB")
LENGTH = _BLOCK.size
EMPTY = bytes(LENGTH)
_ZERO, _NO_FUSION = (0, 0, 0), (0,) * 13

ACC_LSB_PER_M_S2 = 100.0
GYRO_LSB_PER_RAD_S = 16.0 * 180.0 / math.pi
MAG_LSB_PER_UT = 16.0
_GROUPS = {
    reg.ACC_OFFSET + 5: ("accelerometer", reg.ACC_OFFSET, ACC_LSB_PER_M_S2),
    reg.MAG_OFFSET + 5: ("magnetometer", reg.MAG_OFFSET, MAG_LSB_PER_UT),
    reg.GYR_OFFSET + 5: ("gyroscope", reg.GYR_OFFSET, GYRO_LSB_PER_RAD_S),
}
_VECTOR = struct.Struct("<3h")


def encode(sensed: Sensed, mode: Mode, units: int, calibration: int, celsius: float) -> bytes:
    """Return registers 0x08..0x35; outputs that are off in this mode read zero."""
    acc = 1000.0 / GRAVITY_M_S2 if units & UNIT_MG else ACC_LSB_PER_M_S2
    gyro = 900.0 if units & UNIT_RAD_S else GYRO_LSB_PER_RAD_S
    temperature = round((celsius * 1.8 + 32.0) / 2.0 if units & UNIT_FAHRENHEIT else celsius)
    degree = 900.0 if units & UNIT_EULER_RAD else 16.0 * 180.0 / math.pi
    counted: tuple[int, ...] = counts(
        plain(sensed), acc, gyro, MAG_LSB_PER_UT, degree, bool(units & UNIT_ANDROID)
    )
    if not (mode.fusion and mode.accelerometer and mode.gyroscope):  # without magnetometer its field is 0
        counted = (
            *(counted[0:3] if mode.accelerometer else _ZERO),
            *(counted[3:6] if mode.magnetometer else _ZERO),
            *(counted[6:9] if mode.gyroscope else _ZERO),
            *(counted[9:22] if mode.fusion else _NO_FUSION),
        )
    return _BLOCK.pack(*counted, temperature, calibration)


def load_offsets(page: bytearray, address: int, calibration: SelfCalibration) -> None:
    """After a write to `address`: if it completes a sensor's offsets, use them as the offset estimate."""
    group = _GROUPS.get(address)
    if group is None:
        return
    sensor, start, scale = group
    x, y, z = _VECTOR.unpack_from(page, start)
    calibration.restore(sensor, (x / scale, y / scale, z / scale))


def store_offsets(page: bytearray, calibration: SelfCalibration) -> None:
    """Write the offset estimates to the registers, as on entering CONFIG mode."""
    for sensor, start, scale in _GROUPS.values():
        values = [max(-32768, min(32767, round(v * scale))) for v in getattr(calibration, sensor)]
        _VECTOR.pack_into(page, start, *values)
