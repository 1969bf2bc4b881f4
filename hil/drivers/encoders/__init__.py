"""Driver of the external steering encoders on CAN."""

from hil.drivers.encoders.as5045 import decode_word
from hil.drivers.encoders.sensor import As5045Encoders

__all__ = ["As5045Encoders", "decode_word"]
