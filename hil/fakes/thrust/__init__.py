"""Emulated propellers."""
