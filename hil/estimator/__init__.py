"""Pose estimation: odometry, EKF and UKF over late and missing measurements."""
