"""Drivers of the propellers that carry part of the robot's weight."""

from hil.drivers.thrust.teensy_propellers import TeensyThrust

__all__ = ["TeensyThrust"]
