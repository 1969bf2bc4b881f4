"""The model `as5045` of the kind `encoders`."""

from hil.config.encoders import EncodersConfig
from hil.drivers.serial_and_can_models import CanModel


class As5045(CanModel):
    """ams AS5045, one on each steering axis."""

    kind, name, title = "encoders", "as5045", "four AS5045 on a CAN node"
    config, subnet = EncodersConfig, 163
    driver, chip = (
        "hil.drivers.encoders.as5045.driver:As5045Encoders",
        "hil.fakes.encoders.as5045.chip:EncoderNode",
    )
