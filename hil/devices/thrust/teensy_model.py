"""Propellers behind a Teensy on a serial line."""

from __future__ import annotations

from hil.config.thrust import TeensyConfig
from hil.devices.link_models import SerialModel

_PJRC = 0x16C0
_PRODUCTS = (0x0483, 0x0487, 0x0489, 0x048A, 0x048B, 0x048C)
"""Teensyduino's USB types with a serial port."""


class Teensy(SerialModel):
    """Lines to a Teensy, pulses to the propellers' controllers."""

    kind, name, title = "thrust", "teensy", "propellers on a Teensy"
    config = TeensyConfig
    driver, chip = "hil.drivers.thrust:TeensyThrust", "hil.fakes.thrust:TeensyChip"
    usb = tuple((_PJRC, product) for product in _PRODUCTS)
