"""The emulated steering encoders: four AS5045 chips and the CAN node that reads them."""

from hil.fakes.encoders.as5045_chip import EncoderTruthOptions
from hil.fakes.encoders.encoder_node import AXIS_FAULTS, NODE_FAULTS, EncoderNode

__all__ = ["AXIS_FAULTS", "NODE_FAULTS", "EncoderNode", "EncoderTruthOptions"]
