"""The model `teensy` of the kind `thrust`."""

from hil.config.thrust import TeensyConfig
from hil.drivers.serial_and_can_models import SerialModel

_PJRC = 0x16C0


_PRODUCTS = (0x0483, 0x0487, 0x0489, 0x048A, 0x048B, 0x048C)
"""Teensyduino's USB types with a serial port."""


class Teensy(SerialModel):
    """Propellers on a Teensy, which takes lines and sends pulses to their motor controllers."""

    kind, name, title = "thrust", "teensy", "propellers on a Teensy"
    config, wire = TeensyConfig, ""  # it sends nothing
    driver, chip = "hil.drivers.thrust.teensy.driver:TeensyThrust", "hil.fakes.thrust.teensy.chip:TeensyChip"
    usb = tuple((_PJRC, product) for product in _PRODUCTS)
