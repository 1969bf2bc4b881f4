"""BNO055 on its UART."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.config.imu import Bno055Config
from hil.vocabulary.clock import Clock
from hil.vocabulary.interfaces import Sensor
from hil.vocabulary.kinds import DeviceModel, Found
from hil.vocabulary.signals import ImuSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting

_OPEN_TIMEOUT_S = 0.9


def _driver(config: Bno055Config, clock: Clock) -> Sensor[ImuSample]:
    from hil.drivers.imu import Bno055Imu

    return Bno055Imu(config, clock)


def _imperfections() -> type[Any]:
    from hil.fakes.imu import ImuTruthOptions

    return ImuTruthOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.emulated import on_serial_line
    from hil.fakes.imu import Bno055Chip, ImuTruthOptions

    config: Bno055Config = setting.config
    chip = Bno055Chip(
        setting.world,
        options=setting.options(ImuTruthOptions, position_m=config.mount_position_m),
        mount_rotation_wxyz=config.mount_rotation_wxyz,
        bench_remap=(config.axis_map, config.axis_sign),
    )
    return on_serial_line(setting, chip)


def _ask(port: str, clock: Clock) -> Found | None:
    from hil.drivers.imu.bno055 import answers

    config = Bno055Config(port=port, open_timeout_s=_OPEN_TIMEOUT_S)
    return Found({"port": port}) if answers(config, clock) else None


BNO055 = DeviceModel(
    kind="imu",
    name="bno055",
    title="BNO055 on its UART",
    config=Bno055Config,
    driver=_driver,
    emulate=_emulate,
    imperfections=_imperfections,
    ask=_ask,
    ask_writes="a request for the identity of a BNO055, at 115200 baud",
    ask_after=1,
)
