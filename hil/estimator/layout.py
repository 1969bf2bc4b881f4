"""Where every number lives: state, sensor memory, event rows and parameters of the filter kernels.

State (20): pose in the wall frame; body twist; gyro bias; yaw slip per rolled metre; slip velocity (wall
axes); creep, the slip per rolled metre (wall axes); scale error (of the camera or of the wheels);
gravity-heading offset; frame of the tracking camera; pose cloned at the last servo read.
"""

from __future__ import annotations

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.robot.kinematics import WheelGeometry, projection
from hil.vocabulary.geometry import Array

X, Y, THETA, VX, VY, OMEGA = range(6)
BIAS, YAW_SLIP = 6, 7
SLIP_X, SLIP_Y, CREEP_X, CREEP_Y = 8, 9, 10, 11
SCALE, OFFSET = 12, 13
FRAME, CLONE = 14, 17
STATES = 20
STATE_NAMES = (
    "x_m", "y_m", "theta_rad", "v_x_m_s", "v_y_m_s", "omega_rad_s", "gyro_bias_rad_s", "yaw_slip_rad_m",
    "slip_x_m_s", "slip_y_m_s", "creep_x", "creep_y", "scale", "gravity_offset_rad", "frame_x_m",
    "frame_y_m", "frame_theta_rad", "clone_x_m", "clone_y_m", "clone_theta_rad",
)  # fmt: skip

RESET, WHEELS, GYRO, TRACKER, MOCAP = 0, 1, 2, 3, 4
SENSORS = ("reset", "wheels", "gyro", "tracker", "mocap")
ROWS = 8
ROW_DATA = 16

# sensor memory: travels with the state, so that a rewind also rewinds counters and clones
WHEEL_T, WHEEL_ANGLE, WHEEL_STEER = 0, 1, 5
FRAME_T, TRACKER_T, TRACKER_POSE = 9, 10, 11
IN_ROW = 14
ACCEPTED, REJECTED, NIS, NIS_MEAN = 20, 26, 32, 38
REANCHORED = 44
WHEEL_REJECTED = 50
INNOVATION = 54
GUARDED = 58
DUPLICATES = 59
GYRO_T, MOCAP_T = 60, 61
WINDOW = 62
ROLLING = 70
MEMORY = 72
GRAVITY = 5
"""Slot of the gravity heading in the per-sensor tables of the memory (sensor ids take 1 to 4)."""

_NAMES = (
    "unscented", "alpha", "beta", "kappa", "q_speed", "q_turn",
    "slip_m_s", "slip_across_m_s", "slip_s", "creep_walk", "creep_walk_across", "yaw_walk",
    "bias_walk", "drift_m", "drift_s", "yaw_drift",
    "camera_scaled", "wheels_scaled",
    "step_m", "per_m", "per_s", "steering_m", "gap_s", "from_rate", "wheel_rows", "friction_s", "creep",
    "rate_rad_s", "gravity_rad", "gravity_a", "gravity_on",
    "tracker_m", "tracker_rad", "quality", "baseline_s", "jump_m", "jump_rad", "fast_m_s", "fast_rad_s",
    "tracker_on", "mocap_on", "mocap_m", "mocap_rad",
    "gate1", "gate3", "reanchor", "nis_n",
)  # fmt: skip
(
    UNSCENTED, ALPHA, BETA, KAPPA, Q_SPEED, Q_TURN,
    SLIP_M_S, SLIP_ACROSS_M_S, SLIP_S, CREEP_WALK, CREEP_WALK_ACROSS, YAW_WALK,
    BIAS_WALK, DRIFT_M, DRIFT_S, YAW_DRIFT,
    CAMERA_SCALED, WHEELS_SCALED,
    STEP_M, PER_M, PER_S, STEERING_M, GAP_S, FROM_RATE, WHEEL_ROWS, FRICTION_S, CREEP,
    RATE_RAD_S, GRAVITY_RAD, GRAVITY_A, GRAVITY_ON,
    TRACKER_M, TRACKER_RAD, QUALITY, BASELINE_S, JUMP_M, JUMP_RAD, FAST_M_S, FAST_RAD_S,
    TRACKER_ON, MOCAP_ON, MOCAP_M, MOCAP_RAD,
    GATE1, GATE3, REANCHOR, NIS_N,
) = range(len(_NAMES))  # fmt: skip

_NO_GATE = 1e300


def parameters(config: EstimatorConfig, surface: str) -> Array:
    """Parameter vector of the kernels: standard deviations are squared where a variance is needed."""
    w, g, t, c, k = config.wheels, config.gyro, config.tracker, config.mocap, config.gates
    slip = config.wall if surface == "wall" else config.floor
    relative = t.use == "relative"
    walk = [
        slip.creep_per_sqrt_m * (part / slip.creep if slip.creep > 0 else 0.0)
        for part in (slip.creep, slip.creep_across)
    ]
    values = {
        "unscented": config.kind == "ukf", "alpha": config.alpha, "beta": config.beta, "kappa": config.kappa,
        "q_speed": config.process.acceleration_m_s2_sqrt_hz**2,
        "q_turn": config.process.angular_acceleration_rad_s2_sqrt_hz**2,
        "slip_m_s": slip.slip_m_s**2, "slip_across_m_s": slip.slip_across_m_s**2,
        "slip_s": slip.slip_time_s, "creep_walk": walk[0]**2, "creep_walk_across": walk[1]**2,
        "yaw_walk": slip.yaw_per_sqrt_m**2, "bias_walk": g.bias_rad_s_sqrt_s**2,
        "drift_m": t.drift_per_sqrt_m**2 * relative, "drift_s": t.drift_per_sqrt_s**2 * relative,
        "yaw_drift": t.yaw_drift_per_sqrt_s**2 * relative,
        "camera_scaled": t.scale_sigma > 0, "wheels_scaled": config.wheel_scale_sigma > 0,
        "step_m": w.step_m**2, "per_m": w.per_sqrt_m**2, "per_s": w.per_sqrt_s**2,
        "steering_m": w.steering_m_rad**2, "gap_s": w.longest_gap_s, "from_rate": w.source == "velocity",
        "wheel_rows": 8 if w.model == "equations" else 3,
        "friction_s": w.friction_window_s if w.model in ("dry-friction", "creep") else 0.0,
        "creep": w.model == "creep",
        "rate_rad_s": g.rate_rad_s**2, "gravity_rad": g.gravity_rad**2, "gravity_a": g.gravity_per_m_s2**2,
        "gravity_on": g.use_gravity and surface == "wall",
        "tracker_m": t.position_m**2, "tracker_rad": t.heading_rad**2, "quality": t.least_quality,
        "baseline_s": t.baseline_s * relative, "jump_m": t.jump_m if relative else _NO_GATE,
        "jump_rad": t.jump_rad if relative else _NO_GATE, "fast_m_s": t.fastest_m_s,
        "fast_rad_s": t.fastest_rad_s,
        "tracker_on": t.use != "off", "mocap_on": c.use, "mocap_m": c.position_m**2,
        "mocap_rad": c.heading_rad**2,
        "gate1": k.one_dof if k.on else _NO_GATE, "gate3": k.three_dof if k.on else _NO_GATE,
        "reanchor": k.reanchor_after, "nis_n": config.time.nis_samples,
    }  # fmt: skip
    return np.array([float(values[name]) for name in _NAMES])


def prior_variances(config: EstimatorConfig, surface: str) -> Array:
    """Initial variances (20,) of what a start state does not bring; pose and twist are left at zero."""
    slip = config.wall if surface == "wall" else config.floor
    sigma = np.zeros(STATES)
    sigma[BIAS] = config.gyro.bias_rad_s
    sigma[YAW_SLIP] = slip.yaw_rad_m
    sigma[SLIP_X], sigma[SLIP_Y] = slip.slip_m_s, slip.slip_across_m_s
    sigma[CREEP_X], sigma[CREEP_Y] = slip.creep, slip.creep_across
    sigma[SCALE] = max(config.tracker.scale_sigma, config.wheel_scale_sigma)
    if config.gyro.use_gravity and surface == "wall":
        sigma[OFFSET] = config.gyro.gravity_offset_rad
    return sigma**2


def contacts(geometry: WheelGeometry) -> Array:
    """Rows radius, zero, x, y, and relative creep stiffness lengthwise and sideways, shape (6, 4)."""
    g = geometry
    rows = [g.radius_m, g.steering_zero_rad, g.x_m, g.y_m, g.load, g.creep_ratio * g.load]
    return np.array(rows, dtype=np.float64)


def wheel_tables(config: EstimatorConfig, geometry: WheelGeometry) -> tuple[Array, Array]:
    """Per-wheel contacts (6, 4) of `contacts` and the forward rows (8, 11) of the wheel measurement.

    Columns 0-2 of the rows map a body displacement to what is compared; columns 3-10 map the eight
    wheel displacement components to it.
    """
    from hil.robot.kinematics import forward_matrix

    wheels = contacts(geometry)
    rows = np.zeros((ROWS, 11))
    if config.wheels.model == "equations":
        rows[:, :3] = projection(geometry.x_m, geometry.y_m)
        rows[:, 3:] = np.eye(8)
    else:
        model = "paper" if config.wheels.model == "paper" else "exact"
        rows[:3, :3] = np.eye(3)
        rows[:3, 3:] = forward_matrix(geometry.x_m, geometry.y_m, model)
    return wheels, rows
