"""Emulated encoders."""
