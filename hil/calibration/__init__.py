"""Odometry calibration: models, solvers, identifiability, validation, and calibration files."""
