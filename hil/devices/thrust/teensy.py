"""Propellers behind a Teensy on a serial line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.config.thrust import TeensyConfig
from hil.vocabulary.clock import Clock
from hil.vocabulary.interfaces import Holding
from hil.vocabulary.kinds import DeviceModel
from hil.vocabulary.signals import ThrustSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting


def _driver(config: TeensyConfig, clock: Clock) -> Holding[ThrustSample]:
    from hil.drivers.thrust import TeensyThrust

    return TeensyThrust(config, clock)


def _imperfections() -> type[Any]:
    from hil.fakes.thrust import ThrustTruthOptions

    return ThrustTruthOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.emulated import Begun, on_serial_line
    from hil.fakes.thrust import TeensyChip, ThrustTruthOptions

    chip = TeensyChip(setting.world, setting.config, setting.options(ThrustTruthOptions))
    return Begun(on_serial_line(setting, chip), chip.begin_in_use)


_PJRC = 0x16C0
_PRODUCTS = (0x0483, 0x0487, 0x0489, 0x048A, 0x048B, 0x048C)
"""Teensyduino's USB types with a serial port."""

TEENSY = DeviceModel(
    kind="thrust",
    name="teensy",
    title="propellers on a Teensy",
    config=TeensyConfig,
    driver=_driver,
    emulate=_emulate,
    imperfections=_imperfections,
    usb=tuple((_PJRC, product) for product in _PRODUCTS),
)
