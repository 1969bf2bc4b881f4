"""Driver of the BNO055 inertial unit on its UART."""

from hil.drivers.imu.bno055_calibration import ImuCalibration
from hil.drivers.imu.bno055_driver import Bno055Imu

__all__ = ["Bno055Imu", "ImuCalibration"]
