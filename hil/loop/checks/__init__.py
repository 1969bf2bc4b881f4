"""The checks that stop the robot, one module each."""
