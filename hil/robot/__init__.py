"""Mathematics of the robot: kinematics, wheel contact, statics, odometry, trajectories, motion limits."""
