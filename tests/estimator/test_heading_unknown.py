"""A start whose heading is known to 0.2 or 0.5 rad only: both filters find it and say how well."""

import functools

import numpy as np
import pytest
from estimator_drives import true_path, wheel_log
from simulated_sensors import InertialErrors, Path, cycles, inertial, wheel_samples

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import compose
from hil.core.signals import PoseMeasurement, RobotState, Stamp
from hil.estimator import make_estimator
from hil.estimator.nees import nees
from hil.estimator.smoother import smooth
from hil.robot.kinematics import WheelGeometry

FIX_M = 5e-3
CONFIG = EstimatorConfig(mocap={"use": True, "position_m": FIX_M, "heading_rad": 10.0})


def motion(t_s):
    """A quarter of a metre per second along a gentle slalom."""
    return np.array([0.25, 0.05 * np.sin(2.0 * t_s), 0.3 * np.sin(t_s)])


@functools.cache
def drive(sigma_rad, seed, seconds=8.0, first_m=0.0):
    """Two metres on wheels and gyro; positions alone, once a second, from `first_m` driven on."""
    rng = np.random.default_rng(seed)
    path = true_path(seconds, rate_hz=100.0, motion=motion)
    wheels = wheel_samples(*in_steps(path, rng))
    turned = np.array([0.0, 0.0, sigma_rad * rng.normal()])
    path = Path(path.t_s, np.array([compose(turned, pose) for pose in path.pose]))
    gyro = inertial(path, InertialErrors(rate_hz=50.0), rng, on_wall=False)
    fixes = []
    for k in range(100, len(path.t_s), 100):
        if 0.25 * k / 100.0 >= first_m:
            pose = path.pose[k] + FIX_M * rng.normal(size=3) * np.array([1, 1, 0])
            pose[2] = rng.uniform(-3.0, 3.0)
            t_ns = round(path.t_s[k] * 1e9)
            fixes.append(PoseMeasurement(Stamp(t_ns, t_ns, k), "mocap", pose, 3, True))
    begin_ns = round(path.t_s[0] * 1e9) - 1
    start = np.diag([1e-6, 1e-6, sigma_rad**2, 1e-6, 1e-6, 1e-6])
    end_ns, period_ns = round(path.t_s[-1] * 1e9), 20_000_000
    parts = tuple(cycles(begin_ns + period_ns, end_ns, wheels, gyro, (), fixes, period_ns))
    return parts, RobotState(begin_ns, np.zeros(3), motion(0.0), start), path


def in_steps(path, rng):
    t_s, angle, steering, rate = wheel_log(path, 1000.0, rng, motion)
    return t_s[::2], angle[::2], steering[::2], rate[::2]


def followed(config, parts, start):
    estimator = make_estimator(config, WheelGeometry.nominal(), surface="floor")
    estimator.reset(start)
    return [estimator.update(m) for m in parts]


def assert_found(sigma_rad, trials, first_m, kind="ekf"):
    """Position RMSE <= 15 mm and NEES <= 4 (3 is ideal) at the end."""
    squared, errors = [], []
    for seed in range(trials):
        parts, start, path = drive(sigma_rad, seed, first_m=first_m)
        last = followed(CONFIG.model_copy(update={"kind": kind}), parts, start)[-1]
        error = last.pose_body_in_wall - path.at(np.array([last.t_ns * 1e-9]))[0]
        errors.append(np.hypot(*error[:2]))
        squared.append(nees(error[None], last.covariance[None, :3, :3])[0])
        assert last.diagnostics["rejected_mocap"] == 0
    assert np.sqrt(np.mean(np.square(errors))) <= 0.015
    assert np.mean(squared) <= 4.0


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize(("sigma_rad", "first_m"), [(0.2, 0.0), (0.5, 1.0)])
def test_a_heading_that_is_not_known_is_found(kind, sigma_rad, first_m):
    """An additive EKF and a UKF by points alone gate positions out after a metre: 300 mm off (0.2 rad)."""
    assert_found(sigma_rad, 10, first_m, kind)


def test_the_ukf_finds_one_that_is_known_to_seven_degrees():
    """It took such a start, by points alone, and lost the robot in some of 60: RMSE 117 mm, NEES 35."""
    assert_found(0.12, 20, 1.0, "ukf")


@pytest.mark.long
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize("sigma_rad", [0.1, 0.2, 0.5])
@pytest.mark.parametrize("first_m", [0.0, 1.0])
def test_a_heading_that_is_not_known_is_found_in_60_trials(kind, sigma_rad, first_m):
    assert_found(sigma_rad, 60, first_m, kind)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_both_engines_agree_on_it(kind):
    parts, start, _ = drive(0.5, 3, seconds=4.0, first_m=0.5)
    config = CONFIG.model_copy(update={"kind": kind})
    states = followed(config, parts, start)
    other = followed(config.model_copy(update={"engine": "filterpy"}), parts, start)
    for a, b in zip(states, other, strict=True):
        assert np.allclose(a.pose_body_in_wall, b.pose_body_in_wall, atol=1e-8)
        assert np.allclose(a.covariance, b.covariance, atol=1e-8)


def test_the_smoother_agrees_on_it():
    parts, start, path = drive(0.5, 3, seconds=4.0, first_m=0.5)
    states = followed(CONFIG, parts, start)
    smoothed = smooth(CONFIG, WheelGeometry.nominal(), "floor", parts, start)
    assert np.allclose(smoothed[-1].pose_body_in_wall, states[-1].pose_body_in_wall, atol=1e-9)
    first = smoothed[5]
    error = first.pose_body_in_wall - path.at(np.array([first.t_ns * 1e-9]))[0]
    assert abs(error[2]) < 4.0 * np.sqrt(first.covariance[2, 2])
    assert np.sqrt(first.covariance[2, 2]) < 0.1 * 0.5


@pytest.mark.parametrize("sigma_rad", [0.02, 0.05])
def test_the_ukf_goes_less_far_by_half_the_variance_of_the_heading(sigma_rad):
    """A mean position is nearer by the mean of the cosine, as docs/estimation.md says."""
    parts, start, _ = drive(sigma_rad, 0, first_m=np.inf)
    ekf, ukf = (followed(CONFIG.model_copy(update={"kind": kind}), parts, start) for kind in ("ekf", "ukf"))
    ways = np.array([[state.pose_body_in_wall[:2] for state in states] for states in (ekf, ukf)])
    variances = np.array([state.covariance[2, 2] for state in ekf])
    shorter = np.cumsum(0.5 * variances[1:, None] * np.diff(ways[0], axis=0), axis=0)
    apart = (ways[0] - ways[1])[1:]
    assert np.linalg.norm(apart[-1]) > 0.9 * sigma_rad**2  # two metres
    assert np.abs(apart - shorter).max() < 0.03 * np.linalg.norm(apart[-1])
