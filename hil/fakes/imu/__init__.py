"""The emulated BNO055: register map, UART firmware, sensors and fusion."""

from hil.fakes.imu.bno055_chip import SUPPORTED_FAULTS, Bno055Chip
from hil.fakes.imu.sensor_physics import ImuTruthOptions

__all__ = ["SUPPORTED_FAULTS", "Bno055Chip", "ImuTruthOptions"]
