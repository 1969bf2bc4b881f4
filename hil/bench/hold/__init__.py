"""Checks whether the robot is held on its wall; the result is HELD or NOT HELD."""
