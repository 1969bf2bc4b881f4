"""Emulated servos."""
