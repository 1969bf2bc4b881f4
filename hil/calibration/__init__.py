"""Odometry calibration: data sets, models, solvers, identifiability, validation."""
