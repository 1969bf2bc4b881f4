"""What stops the robot: each check, with what it sees."""
