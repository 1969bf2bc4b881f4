"""Emulated inertial units."""
