"""MicroStrain (HBK) 3DM-CV7 and 3DM-GV7 on a serial port, which speak the public MIP protocol.

Why this one beside the BNO055, which is no longer made: it can be bought, its maker publishes protocol and an
SDK under the MIT licence, and one packet holds attitude, rates, linear acceleration, gravity, the filter's
state and the sensor's own time, from 100 to 1000 times a second.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.devices.imu.microstrain.config import MicrostrainConfig
from hil.devices.imu.microstrain.look import look
from hil.vocabulary.clock import Clock
from hil.vocabulary.interfaces import Sensor
from hil.vocabulary.kinds import DeviceModel, Found
from hil.vocabulary.signals import ImuSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting

_BAUDS = (115_200, 921_600)
_OPEN_TIMEOUT_S = 0.4


def _driver(config: MicrostrainConfig, clock: Clock) -> Sensor[ImuSample]:
    from hil.devices.imu.microstrain.driver import MicrostrainImu

    return MicrostrainImu(config, clock)


def _imperfections() -> type[Any]:
    from hil.devices.imu.microstrain.sensing import MicrostrainTruthOptions

    return MicrostrainTruthOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.emulated import on_serial_line
    from hil.devices.imu.microstrain.chip import MicrostrainChip
    from hil.devices.imu.microstrain.sensing import MicrostrainTruthOptions

    config: MicrostrainConfig = setting.config
    chip = MicrostrainChip(
        setting.world,
        options=setting.options(MicrostrainTruthOptions, position_m=config.mount_position_m),
        mount_rotation_wxyz=config.mount_rotation_wxyz,
        baud=config.baud,
    )
    return on_serial_line(setting, chip)


def _ask(port: str, clock: Clock) -> Found | None:
    """As delivered, and as fast as it can be set."""
    from hil.devices.imu.microstrain.dialogue import answers

    for baud in _BAUDS:
        config = MicrostrainConfig(port=port, baud=baud, open_timeout_s=_OPEN_TIMEOUT_S)
        if answers(config, clock):
            return Found({"port": port} if baud == _BAUDS[0] else {"port": port, "baud": baud})
    return None


MICROSTRAIN = DeviceModel(
    kind="imu",
    name="microstrain",
    title="MicroStrain 3DM-CV7 or 3DM-GV7 on a serial port",
    config=MicrostrainConfig,
    driver=_driver,
    emulate=_emulate,
    imperfections=_imperfections,
    ask=_ask,
    ask_writes="a request for the identity of a MicroStrain sensor, at 115200 and 921600 baud",
    ask_after=2,
    look=look,
)
