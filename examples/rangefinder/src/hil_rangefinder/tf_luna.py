"""The model `tf_luna`: Benewake TF-Luna on its serial port."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.vocabulary.clock import Clock, nanoseconds
from hil.vocabulary.errors import HilError
from hil.vocabulary.interfaces import Sensor
from hil.vocabulary.kinds import DeviceModel, Found
from hil_rangefinder.config import TfLunaConfig
from hil_rangefinder.sample import RangeSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting

_ASK_S = 0.3


def _driver(config: TfLunaConfig, clock: Clock) -> Sensor[RangeSample]:
    from hil_rangefinder.driver import TfLuna

    return TfLuna(config, clock)


def _imperfections() -> type[Any]:
    from hil_rangefinder.chip import RangeTruthOptions

    return RangeTruthOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.emulated import on_serial_line
    from hil_rangefinder.chip import RangeTruthOptions, TfLunaChip

    options = setting.options(RangeTruthOptions)
    return on_serial_line(setting, TfLunaChip(setting.world, setting.config, options))


def _ask(port: str, clock: Clock) -> Found | None:
    """Ask for the firmware; a sensor that is only looked for keeps its settings."""
    from hil_rangefinder.driver import firmware
    from hil_rangefinder.link import Link
    from hil_rangefinder.packets import VERSION

    try:
        link = Link("rangefinder", port, TfLunaConfig(port=port).baud, clock)
    except HilError:
        return None
    try:
        version = link.ask(VERSION, until_ns=clock.now_ns() + nanoseconds(_ASK_S))
    except HilError:
        return None
    finally:
        link.close()
    if version is None or len(version) != 3:
        return None
    return Found({"port": port}, notes=(f"TF-Luna at {port}, firmware {firmware(version)}",))


TF_LUNA = DeviceModel(
    kind="rangefinder",
    name="tf_luna",
    title="Benewake TF-Luna on its serial port",
    config=TfLunaConfig,
    driver=_driver,
    emulate=_emulate,
    imperfections=_imperfections,
    ask=_ask,
    ask_writes="a request for the version of a TF-Luna, at 115200 baud",
    ask_after=2,
)
