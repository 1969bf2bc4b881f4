"""BNO055 on its UART."""

from __future__ import annotations

from hil.config.imu import Bno055Config
from hil.devices.link_models import SerialModel


class Bno055(SerialModel):
    """Bosch BNO055."""

    kind, name, title = "imu", "bno055", "BNO055 on its UART"
    config = Bno055Config
    driver, chip = "hil.drivers.imu:Bno055Imu", "hil.fakes.imu:Bno055Chip"
    probe_order, probe_bauds = 1, (115_200,)
    probe_writes = "a request for the identity of a BNO055, at 115200 baud"
