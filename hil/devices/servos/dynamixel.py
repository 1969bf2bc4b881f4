"""Dynamixel X servos on their half-duplex bus, Protocol 2.0."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.config.servo_models import DEFAULT_MODEL
from hil.config.servos import ServosConfig
from hil.vocabulary.clock import Clock
from hil.vocabulary.interfaces import Actuators
from hil.vocabulary.kinds import DeviceModel

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting


def _driver(config: ServosConfig, clock: Clock) -> Actuators:
    from hil.drivers.servos import DynamixelServos

    return DynamixelServos(config, clock)


def _imperfections() -> type[Any]:
    from hil.fakes.servos import ServoBusOptions

    return ServoBusOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.emulated import on_serial_line
    from hil.fakes.servos import ServoBus, ServoBusOptions

    config: ServosConfig = setting.config
    known = {"ids": config.ids, "baud": config.baud, "model_number": config.model_number or DEFAULT_MODEL}
    options = setting.options(ServoBusOptions, **known)
    told = {"baud": config.baud, "ids": list(config.ids)}
    return on_serial_line(
        setting, ServoBus(setting.world, options=options), latency_s=config.usb_latency_s, told=told
    )


def _ask(port: str, clock: Clock) -> Any:
    from hil.devices.servos.discovery import ask

    return ask(port, clock)


DYNAMIXEL = DeviceModel(
    kind="servos",
    name="dynamixel",
    title="Dynamixel X servos on RS-485 or TTL",
    config=ServosConfig,
    driver=_driver,
    emulate=_emulate,
    imperfections=_imperfections,
    ask=_ask,
    ask_writes="a ping of all Dynamixel servos, at each of their baud rates",
    ask_after=9,
)
