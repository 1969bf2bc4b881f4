"""The parts of a control cycle: reading devices, checking and aligning data, control, sending."""
