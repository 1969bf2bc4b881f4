"""Motor controllers on CAN that the fan daemon commands: what fans and propellers share."""
