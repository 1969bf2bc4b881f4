"""Emulated devices: models of the chips, the buses that connect them, and the robot they are mounted on."""
