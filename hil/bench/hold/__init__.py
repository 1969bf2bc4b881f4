"""Whether the robot is held on its wall, and what keeps it there."""
