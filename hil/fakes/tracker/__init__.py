"""Emulated tracking cameras."""
