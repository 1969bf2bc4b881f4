"""Drivers of the propellers that carry part of the robot's weight."""

from hil.drivers.thrust.teensy import TeensyThrust

__all__ = ["TeensyThrust"]
