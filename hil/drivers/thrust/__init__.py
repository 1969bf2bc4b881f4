"""Propellers that carry part of the robot's weight."""
