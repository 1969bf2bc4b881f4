"""Emulated load cells."""
