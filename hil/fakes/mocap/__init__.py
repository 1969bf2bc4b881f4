"""Emulated motion capture systems."""
