"""The 22 calibration bytes 0x55..0x6A of the emulated BNO055 and the offsets they stand for.

One count is 0.01 m/s^2, 1/16 degree/s, 1/16 uT. A group takes effect when its last byte is written.
"""

from __future__ import annotations

import struct

from hil.fakes.imu import bno055_registers as reg
from hil.fakes.imu.register_encoding import ACC_LSB_PER_M_S2, GYRO_LSB_PER_RAD_S, MAG_LSB_PER_UT
from hil.fakes.imu.self_calibration import SelfCalibration

_GROUPS = {
    reg.ACC_OFFSET + 5: ("accelerometer", reg.ACC_OFFSET, ACC_LSB_PER_M_S2),
    reg.MAG_OFFSET + 5: ("magnetometer", reg.MAG_OFFSET, MAG_LSB_PER_UT),
    reg.GYR_OFFSET + 5: ("gyroscope", reg.GYR_OFFSET, GYRO_LSB_PER_RAD_S),
}
_VECTOR = struct.Struct("<3h")


def load_offsets(page: bytearray, address: int, calibration: SelfCalibration) -> None:
    """After a write to `address`: a completed group becomes the chip's offset estimate."""
    group = _GROUPS.get(address)
    if group is None:
        return
    sensor, start, scale = group
    x, y, z = _VECTOR.unpack_from(page, start)
    calibration.restore(sensor, (x / scale, y / scale, z / scale))


def store_offsets(page: bytearray, calibration: SelfCalibration) -> None:
    """Show the chip's own estimates in the registers, as on entering CONFIG mode."""
    for sensor, start, scale in _GROUPS.values():
        values = [max(-32768, min(32767, round(v * scale))) for v in getattr(calibration, sensor)]
        _VECTOR.pack_into(page, start, *values)
