"""A fan on a VESC with the VESC's own CAN protocol."""
