"""Side by side with WPILib's pose estimator on its own kind of accuracy stream, 20 seeds in one run.

Wheels with 5 % of speed noise, an absolute heading with 0.05 rad, a pose with 0.1 m and 0.05 rad at 10 Hz
that comes 250 ms late, 20 ms steps, 8.72 s. WPILib's filter is run twice: with the standard deviations that
its own accuracy test ships, and with those that do best on this very stream.
"""

import numpy as np
import pytest
from scipy.optimize import minimize

from hil.config.estimator import EstimatorConfig
from hil.core.geometry import compose, se2_exp
from hil.core.signals import (
    GyroMeasurement,
    Measurements,
    PoseMeasurement,
    RobotState,
    Stamp,
    WheelMeasurement,
)
from hil.estimator import make_estimator
from hil.robot.kinematics import WheelGeometry
from tests.selected import every

_estimator, _geometry, _kinematics = (
    pytest.importorskip(f"wpimath.{name}", reason="robotpy-wpimath has no wheel for this computer")
    for name in ("estimator", "geometry", "kinematics")
)
DT_S, STEPS, LATE = 0.02, 436, 13
X, Y = np.array([1.0, 1.0, -1.0, -1.0]), np.array([1.0, -1.0, -1.0, 1.0])
RADIUS_M = 0.05
STAMP_NS = 20_000_000


def twist(t_s):
    """A figure of eight at up to 2 m/s that starts and ends at rest."""
    speed = min(2.0, 2.0 * t_s, 2.0 * max(0.0, STEPS * DT_S - t_s))
    return np.array([speed, 0.0, 0.9 * speed * np.sin(2 * np.pi * t_s / (STEPS * DT_S))])


def stream(seed):
    """True poses, wheel distances and headings, measured headings, (step, pose) of vision."""
    rng = np.random.default_rng(seed)
    geometry = WheelGeometry(X, Y, np.full(4, RADIUS_M))
    pose, distance = np.zeros(3), np.zeros(4)
    truth, distances, angles, headings, vision = [pose], [distance], [np.zeros(4)], [0.0], []
    for k in range(STEPS):
        b = twist((k + 0.5) * DT_S)
        pose = compose(pose, se2_exp(b * DT_S))
        u = (geometry.projection() @ b).reshape(4, 2)
        distance = distance + np.hypot(u[:, 0], u[:, 1]) * DT_S * (1 + 0.05 * rng.normal(size=4))
        truth.append(pose)
        distances.append(distance)
        angles.append(np.arctan2(u[:, 1], u[:, 0]) + 0.005 * rng.normal(size=4))
        headings.append(pose[2] + 0.05 * rng.normal())
        if k % 5 == 4:
            vision.append((k + 1, pose + np.array([0.1, 0.1, 0.05]) * rng.normal(size=3)))
    return np.array(truth), distances, angles, headings, vision


SHIPPED, TUNED = (0.45, 0.45, 0.45), (4.08, 4.08, 13.7)
"""Sigmas of vision: as shipped, and those that do best on these streams."""


def theirs(distances, angles, headings, vision, vision_sigma):
    """Only the ratio of vision to odometry sigmas counts, axis by axis, so odometry's stay at 0.1."""
    kinematics = _kinematics.SwerveDrive4Kinematics(
        *[_geometry.Translation2d(float(x), float(y)) for x, y in zip(X, Y, strict=True)]
    )

    def modules(k):
        pairs = zip(distances[k].tolist(), angles[k].tolist(), strict=True)
        return tuple(_kinematics.SwerveModulePosition(d, _geometry.Rotation2d(a)) for d, a in pairs)

    filter_ = _estimator.SwerveDrive4PoseEstimator(
        kinematics, _geometry.Rotation2d(0.0), modules(0), _geometry.Pose2d(), (0.1, 0.1, 0.1), vision_sigma
    )
    out, waiting = [np.zeros(2)], list(vision)
    for k in range(1, STEPS + 1):
        while waiting and waiting[0][0] + LATE <= k:
            at, z = waiting.pop(0)
            filter_.addVisionMeasurement(
                _geometry.Pose2d(float(z[0]), float(z[1]), _geometry.Rotation2d(float(z[2]))), at * DT_S
            )
        pose = filter_.updateWithTime(k * DT_S, _geometry.Rotation2d(headings[k]), modules(k))
        out.append(np.array([pose.x, pose.y]))
    return np.array(out)


CONFIG = EstimatorConfig(
    process={"acceleration_m_s2_sqrt_hz": 0.4, "angular_acceleration_rad_s2_sqrt_hz": 0.4},
    wheels={"per_sqrt_m": 0.01, "step_m": 1e-4, "longest_gap_s": 1.0},
    wall={
        "slip_m_s": 0.0,
        "slip_across_m_s": 0.0,
        "creep": 0.0,
        "creep_across": 0.0,
        "yaw_rad_m": 0.0,
        "yaw_per_sqrt_m": 0.0,
    },
    gyro={"gravity_rad": 0.05, "gravity_per_m_s2": 0.0, "gravity_offset_rad": 0.0},
    tracker={"use": "off"},
    mocap={"use": True, "position_m": 0.1, "heading_rad": 0.05},
)


def ours(distances, angles, headings, vision, kind):
    config = CONFIG.model_copy(update={"kind": kind})
    filter_ = make_estimator(config, WheelGeometry(X, Y, np.full(4, RADIUS_M)), surface="wall")
    sigma = np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3])
    filter_.reset(RobotState(-1000, np.zeros(3), np.zeros(3), np.diag(sigma**2)))
    out, waiting = [], list(vision)
    for k in range(STEPS + 1):
        t_ns = k * STAMP_NS
        stamp = Stamp(t_ns, t_ns, k)
        late = []
        while waiting and waiting[0][0] + LATE <= k:
            at, z = waiting.pop(0)
            late.append(PoseMeasurement(Stamp(at * STAMP_NS, t_ns, at), "mocap", z, 3, True))
        wheels = WheelMeasurement(stamp, distances[k] / RADIUS_M, np.zeros(4), angles[k], (True,) * 4)
        gyro = GyroMeasurement(stamp, float("nan"), headings[k], np.zeros(2))
        state = filter_.update(Measurements(k, t_ns, (wheels,), (gyro,), (), tuple(late)))
        out.append(state.pose_body_in_wall[:2])
    return np.array(out)


def errors(path, truth):
    return np.hypot(*(path - truth[:, :2]).T)


def summary(paths, truths):
    """Mean error over all steps and worst of any step, m."""
    every = np.array([errors(path, truth) for path, truth in zip(paths, truths, strict=True)])
    return float(every.mean()), float(every.max())


@pytest.fixture(scope="module")
def streams():
    return [stream(seed) for seed in range(20)]


def scored(streams, sigma):
    """(mean, worst) of WPILib's filter, m."""
    return summary([theirs(*rest, sigma) for _, *rest in streams], [truth for truth, *_ in streams])


@pytest.mark.long
def test_no_other_sigmas_do_better_for_wpimath(streams):
    """Tuned on the streams that it is scored on, which is more than a user could do and in its favour."""

    def mean(logs):
        position, heading = np.exp(logs)
        return scored(streams, (position, position, heading))[0]

    first = np.log([[1.0, 1.0], [3.0, 1.0], [1.0, 5.0]])
    options = {"xatol": 0.05, "fatol": 2e-5, "maxfev": 80, "initial_simplex": first}
    found = minimize(mean, first[0], method="Nelder-Mead", options=options)
    assert scored(streams, TUNED)[0] == pytest.approx(found.fun, rel=0.01)


@pytest.mark.parametrize("kind", every(2, ["ekf", "ukf"]))
def test_accuracy_is_better_than_wpimath(streams, kind):
    """At most 0.025 m and 0.10 m; below theirs at its best, by what docs/estimation.md states."""
    mean, worst = summary([ours(*rest, kind) for _, *rest in streams], [truth for truth, *_ in streams])
    shipped, tuned = scored(streams, SHIPPED), scored(streams, TUNED)
    assert mean <= 0.025
    assert worst <= 0.10
    assert mean < tuned[0] < 0.65 * shipped[0]
    assert worst < tuned[1] < 0.75 * shipped[1]
    assert tuned[0] / mean == pytest.approx(1.3, abs=0.1)
