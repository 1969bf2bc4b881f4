"""Inertial units."""
