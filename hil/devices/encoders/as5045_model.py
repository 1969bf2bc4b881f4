"""Four AS5045 behind a microcontroller that sends them on CAN."""

from __future__ import annotations

from hil.config.encoders import EncodersConfig
from hil.devices.link_models import CanModel


class As5045(CanModel):
    """ams AS5045, one on each steering axis."""

    kind, name, title = "encoders", "as5045", "four AS5045 on a CAN node"
    config, subnet = EncodersConfig, 163
    driver, chip = "hil.drivers.encoders:As5045Encoders", "hil.fakes.encoders:EncoderNode"
