"""Pose tracking: control laws, the module layer, limits."""
