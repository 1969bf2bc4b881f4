"""Odometry says how far it may be off: by creep and turn that stay the same, and by a slow slip."""

import math

import numpy as np
import pytest

from hil.config.estimator import EstimatorConfig, SlipModel, WheelNoise
from hil.core.signals import Measurements, RobotState, Stamp, WheelMeasurement
from hil.estimator import make_estimator
from hil.robot.kinematics import WheelGeometry

STEP_NS, STEP_M = 20_000_000, 0.002
SLIPS = np.array([0.05, 0.002, 0.05])
NAMES = ("creep", "creep_across", "yaw_rad_m")
STILL = RobotState(0, np.zeros(3), np.zeros(3), np.zeros((6, 6)))
WALL = {"slip_m_s": 0.0, "slip_across_m_s": 0.0, **dict(zip(NAMES, SLIPS.tolist(), strict=True))}


def odometry(surface="wall", **slip):
    model = SlipModel(**(WALL | slip))
    config = EstimatorConfig(
        kind="odometry", wall=model, floor=model, wheels=WheelNoise(per_sqrt_m=0.0, step_m=1e-9)
    )
    return make_estimator(config, WheelGeometry.nominal(), surface=surface)


def rolled(steering_rad, metres=1.5, **model):
    """State of odometry after a way in that direction."""
    estimator, geometry = odometry(**model), WheelGeometry.nominal()
    estimator.reset(STILL)
    steering, per_step = np.full(4, steering_rad), STEP_M / geometry.radius_m
    for k in range(round(metres / STEP_M) + 1):
        t_ns = k * STEP_NS
        sample = WheelMeasurement(Stamp(t_ns, t_ns, k), k * per_step, np.zeros(4), steering, (True,) * 4)
        state = estimator.update(Measurements(k, t_ns, wheels=(sample,)))
    return state


def true_end(steering_rad, slips, metres=1.5):
    """Where a robot is that creeps and turns on that way, pose (3,)."""
    truth = np.zeros(3)
    for _ in range(round(metres / STEP_M)):
        middle = steering_rad + truth[2] + 0.5 * slips[2] * STEP_M
        truth += STEP_M * np.array([math.cos(middle) + slips[0], math.sin(middle) + slips[1], slips[2]])
    return truth


@pytest.mark.parametrize("steering_rad", [0.0, 0.5, math.pi / 2])
def test_its_errors_are_as_large_as_it_says(steering_rad):
    """Robots drawn from the prior: NEES has the mean 3 of its three degrees of freedom."""
    rng, count = np.random.default_rng(4), 40
    state = rolled(steering_rad)
    information = np.linalg.inv(state.covariance[:3, :3])
    truths = [true_end(steering_rad, SLIPS * rng.normal(size=3)) for _ in range(count)]
    errors = np.array(truths) - state.pose_body_in_wall
    nees = np.einsum("ni,ij,nj->n", errors, information, errors).mean()
    assert abs(nees - 3.0) < 4.0 * math.sqrt(6.0 / count)


@pytest.mark.parametrize("name", NAMES)
def test_one_slip_alone_is_the_square_of_its_error(name):
    """By finite differences: the covariance of a robot that has one slip is that slip's error squared."""
    one = dict.fromkeys(NAMES, 0.0) | {name: 1e-4}
    state = rolled(0.5, **one)
    error = true_end(0.5, list(one.values())) - state.pose_body_in_wall
    assert np.abs(error).max() > 1e-4
    assert state.covariance[:3, :3] == pytest.approx(np.outer(error, error), rel=1e-3, abs=1e-14)


def test_a_slow_slip_grows_as_its_process_does():
    """Place of an Ornstein-Uhlenbeck velocity: 2 s^2 T (t - T (1 - exp(-t / T)))."""
    sigma, tau_s, t_s = 0.002, 5.0, 12.0
    none = dict.fromkeys(NAMES, 0.0)
    state = rolled(0.0, metres=t_s * STEP_M * 1e9 / STEP_NS, slip_m_s=sigma, slip_time_s=tau_s, **none)
    expected = 2.0 * sigma**2 * tau_s * (t_s - tau_s * (1.0 - math.exp(-t_s / tau_s)))
    assert state.covariance[0, 0] == pytest.approx(expected, rel=0.01)
    assert state.covariance[1, 1] < 1e-6 * expected


def test_the_floor_has_a_slip_of_its_own():
    config = EstimatorConfig(kind="odometry")
    wall, floor = (
        make_estimator(config, WheelGeometry.nominal(), surface=name) for name in ("wall", "floor")
    )
    spreads = []
    for estimator in (wall, floor):
        estimator.reset(STILL)
        for k in range(100):
            stamp = Stamp(k * STEP_NS, k * STEP_NS, k)
            sample = WheelMeasurement(stamp, np.full(4, 0.08 * k), np.zeros(4), np.zeros(4), (True,) * 4)
            state = estimator.update(Measurements(k, stamp.t_ns, wheels=(sample,)))
        spreads.append(math.sqrt(state.covariance[0, 0]))
    assert spreads[0] > 5.0 * spreads[1]
