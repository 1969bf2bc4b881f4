"""Driver of the BNO055 inertial unit on its UART."""

from hil.drivers.imu.bno055 import Bno055Imu
from hil.drivers.imu.calibration import ImuCalibration

__all__ = ["Bno055Imu", "ImuCalibration"]
