"""Driver of the external steering encoders on CAN."""

from hil.drivers.encoders.as5045_word import decode_word
from hil.drivers.encoders.driver import As5045Encoders

__all__ = ["As5045Encoders", "decode_word"]
