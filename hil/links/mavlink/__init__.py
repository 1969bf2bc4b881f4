"""MAVLink odometry: messages, and how they are carried."""
