"""HELD or NOT HELD: how the robot is held on its wall, and the checks of it."""
