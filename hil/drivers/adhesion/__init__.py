"""Ducted fans that press the robot on its surface."""
