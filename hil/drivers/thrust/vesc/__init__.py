"""Propellers on VESC motor controllers."""
