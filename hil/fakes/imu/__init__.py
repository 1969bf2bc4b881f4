"""The emulated BNO055: register map, UART firmware, sensors and fusion."""

from hil.fakes.imu.chip import SUPPORTED_FAULTS, Bno055Chip
from hil.fakes.imu.sensors import ImuTruthOptions

__all__ = ["SUPPORTED_FAULTS", "Bno055Chip", "ImuTruthOptions"]
