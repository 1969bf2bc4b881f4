"""The emulated visual-inertial computer that sends MAVLink odometry."""
