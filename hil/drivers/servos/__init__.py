"""Driver of the eight servos on their bus, and functions to find them and to set one up."""

from hil.drivers.servos.commissioning import FoundServo, scan, set_up
from hil.drivers.servos.driver import DynamixelServos

__all__ = ["DynamixelServos", "FoundServo", "scan", "set_up"]
