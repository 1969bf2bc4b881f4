"""Examination of a bench that does not move: devices, host, robot record, discovery."""
