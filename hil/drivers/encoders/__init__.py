"""Driver of the external steering encoders on CAN."""

from hil.drivers.encoders.as5045 import decode_word
from hil.drivers.encoders.crosscheck import CrossCheck, CrossCheckResult
from hil.drivers.encoders.sensor import As5045Encoders

__all__ = ["As5045Encoders", "CrossCheck", "CrossCheckResult", "decode_word"]
