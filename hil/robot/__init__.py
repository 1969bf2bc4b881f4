"""The robot's mathematics: kinematics, wheel contact, odometry, trajectories and what they may ask."""
