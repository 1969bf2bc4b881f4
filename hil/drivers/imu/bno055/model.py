"""The model `bno055` of the kind `imu`."""

from hil.config.imu import Bno055Config
from hil.drivers.serial_and_can_models import SerialModel


class Bno055(SerialModel):
    """The Bosch BNO055 IMU on a serial port."""

    kind, name, title = "imu", "bno055", "BNO055 on its UART"
    config, wire, framing = Bno055Config, "bus", "bno055"
    driver, chip = "hil.drivers.imu.bno055.driver:Bno055Imu", "hil.fakes.imu.bno055.chip:Bno055Chip"
    probe_order, probe_bauds = 1, (115_200,)
    probe_writes = "a request for the identity of a BNO055, at 115200 baud"
