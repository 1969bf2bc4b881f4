"""Driver of the eight XH430 servos on their bus, and functions to find them and to set one up."""

from hil.drivers.servos.commissioning import FoundServo, scan, set_up
from hil.drivers.servos.xh430 import XH430Servos

__all__ = ["FoundServo", "XH430Servos", "scan", "set_up"]
