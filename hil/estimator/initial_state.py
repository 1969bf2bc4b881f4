"""Start state of an estimator: checks, and the initial state and covariance of the filter."""

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.errors import UsageError
from hil.core.geometry import Array
from hil.core.signals import RobotState
from hil.estimator.state_vector import MOTION, POSE, STATES, TWIST, prior_variances


def start_of(config: EstimatorConfig, surface: str, state: RobotState) -> tuple[Array, Array]:
    """Initial state (20,) and covariance (20, 20) of a filter that starts from a known state.

    Raises:
        UsageError: the state is not finite or its covariance is not a covariance.
    """
    check_state(state)
    x, p = np.zeros(STATES), np.diag(prior_variances(config, surface))
    x[POSE], x[TWIST] = state.pose_body_in_wall, state.twist_body
    p[:MOTION, :MOTION] = 0.5 * (state.covariance + state.covariance.T)
    return x, p


def check_state(state: RobotState) -> None:
    """Refuse a start state that no filter can run from.

    Raises:
        UsageError: the message names what is wrong.
    """
    pose, twist = np.asarray(state.pose_body_in_wall), np.asarray(state.twist_body)
    if pose.shape != (3,) or twist.shape != (3,) or not np.all(np.isfinite(np.r_[pose, twist])):
        raise UsageError(f"start state: pose {pose}, twist {twist}", expected="three finite numbers each")
    covariance = np.asarray(state.covariance)
    if covariance.shape != (MOTION, MOTION) or not np.all(np.isfinite(covariance)):
        raise UsageError("start state: covariance", expected="a finite 6x6 matrix of pose and twist")
    size = float(np.max(np.abs(covariance)))
    if np.max(np.abs(covariance - covariance.T)) > 1e-9 * size:
        raise UsageError("start state: covariance is not symmetric")
    least = float(np.linalg.eigvalsh(covariance)[0])
    if least < -1e-9 * size:
        raise UsageError(
            f"start state: covariance has the eigenvalue {least:.3g}", expected="none below zero"
        )
