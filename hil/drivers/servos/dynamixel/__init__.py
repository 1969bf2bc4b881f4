"""Dynamixel X servos on their bus: driver, search and set-up."""
