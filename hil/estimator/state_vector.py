"""State vector of the filter: the index of each state. The covariance uses the same indices.

Twenty states: pose in the wall frame (m, m, rad); body twist (m/s, m/s, rad/s); pose in the tracking camera's
own frame, including its scale error; scale error (of the camera or of the wheels); gyro bias (rad/s); yaw
slip per rolled metre (rad/m); slip velocity (wall axes, m/s); creep, the slip per rolled metre (wall axes,
m/m); offset of the gravity heading (rad); pose cloned at the last servo read.
"""

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import Array

STATES = 20
(
    X,
    Y,
    THETA,
    V_X,
    V_Y,
    OMEGA,
    CAMERA_X,
    CAMERA_Y,
    CAMERA_THETA,
    SCALE,
    BIAS,
    YAW_SLIP,
    SLIP_X,
    SLIP_Y,
    CREEP_X,
    CREEP_Y,
    OFFSET,
    CLONE_X,
    CLONE_Y,
    CLONE_THETA,
) = range(STATES)

POSE = slice(X, THETA + 1)
TWIST = slice(V_X, OMEGA + 1)
CLONE = slice(CLONE_X, CLONE_THETA + 1)
MOTION = OMEGA + 1
"""Number of leading states that are pose and twist; these are published."""
CURVED = SCALE + 1
"""Number of leading states that enter the nonlinear part of the process model."""

ROWS = 8
"""Largest number of rows that one sample has."""
AUX = 5
"""Largest number of figures, beside the state, that the prediction of a sample's rows needs."""


def prior_variances(config: EstimatorConfig, surface: str) -> Array:
    """Initial variances (20,) of the states that a start state does not contain; pose and twist 0."""
    slip = config.slip(surface)
    sigma = np.zeros(STATES)
    sigma[BIAS] = config.gyro.bias_rad_s
    sigma[YAW_SLIP] = slip.yaw_rad_m
    sigma[SLIP_X], sigma[SLIP_Y] = slip.slip_m_s, slip.slip_across_m_s
    sigma[CREEP_X], sigma[CREEP_Y] = slip.creep, slip.creep_across
    sigma[SCALE] = max(config.tracker.scale_sigma, config.wheel_scale_sigma)
    if config.gyro.use_gravity and surface == "wall":
        sigma[OFFSET] = config.gyro.gravity_offset_rad
    return sigma**2
