"""Emulated fans; their motors and controllers are in `hil.fakes.motor_controllers`."""
