"""Emulated motor controllers on CAN: motor, battery, fan or propellers, and their daemon."""
