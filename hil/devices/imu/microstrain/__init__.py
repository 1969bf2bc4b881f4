"""MicroStrain (HBK) 3DM-CV7 and 3DM-GV7 on a serial port, which speak the public MIP protocol.

Why this one beside the BNO055, which is no longer made: it can be bought, its maker publishes protocol and an
SDK under the MIT licence, and one packet holds attitude, rates, linear acceleration, gravity, the filter's
state and the sensor's own time, from 100 to 1000 times a second.
"""

from __future__ import annotations

from collections.abc import Iterable

from hil.core.finding import Finding
from hil.devices.doctor_watch import Watched
from hil.devices.imu.microstrain.config import MicrostrainConfig
from hil.devices.imu.microstrain.doctor_check import look
from hil.devices.link_models import SerialModel

_HERE = "hil.devices.imu.microstrain"


class MicroStrain(SerialModel):
    """3DM-CV7 or 3DM-GV7."""

    kind, name, title = "imu", "microstrain", "MicroStrain 3DM-CV7 or 3DM-GV7 on a serial port"
    config = MicrostrainConfig
    driver, chip = f"{_HERE}.driver:MicrostrainImu", f"{_HERE}.emulated_chip:MicrostrainChip"
    probe_order, probe_bauds = 2, (115_200, 921_600)  # as delivered, and as fast as it can be set
    probe_writes = "a request for the identity of a MicroStrain sensor, at 115200 and 921600 baud"

    def check(self, watched: Watched) -> Iterable[Finding]:
        """Filter state and settings."""
        return look(watched)
