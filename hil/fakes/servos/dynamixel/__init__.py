"""The emulated servo bus: eight Dynamixel servos with firmware, timing and faults."""
