"""Kinematics against its laws and against robotpy-wpimath."""

import numpy as np
import pytest

from hil.core.errors import UsageError
from hil.core.geometry import compose, se2_exp
from hil.robot import kinematics as k
from hil.robot import odometry as o

CAD = k.WheelGeometry.nominal()


def random_geometry(rng):
    return k.WheelGeometry(
        CAD.x_m * (1 + 0.1 * rng.standard_normal(4)),
        CAD.y_m * (1 + 0.1 * rng.standard_normal(4)),
        CAD.radius_m * (1 + 0.05 * rng.standard_normal(4)),
        0.05 * rng.standard_normal(4),
    )


def test_both_directions_agree_with_wpimath_on_two_thousand_states():
    pytest.importorskip("wpimath", reason="robotpy-wpimath has no wheel for this computer")
    from wpimath.geometry import Rotation2d, Translation2d
    from wpimath.kinematics import SwerveDrive4Kinematics, SwerveModuleState

    rng, found, expected = np.random.default_rng(0), [], []
    for _ in range(20):
        geometry = random_geometry(rng)
        theirs = SwerveDrive4Kinematics(
            *(Translation2d(x, y) for x, y in zip(geometry.x_m, geometry.y_m, strict=True))
        )
        for _ in range(100):
            speed, heading = rng.uniform(-1, 1, 4), rng.uniform(-np.pi, np.pi, 4)
            states = [SwerveModuleState(v, Rotation2d(d)) for v, d in zip(speed, heading, strict=True)]
            chassis = theirs.toChassisSpeeds(states)
            ours = k.forward(geometry, speed, heading + geometry.steering_zero_rad)
            v, d = k.inverse(geometry, ours)
            found += [*ours, *k.wheel_vectors(v, d - geometry.steering_zero_rad)]
            back = theirs.toSwerveModuleStates(chassis)
            v, d = np.array([(b.speed, b.angle.radians()) for b in back]).T
            expected += [chassis.vx, chassis.vy, chassis.omega, *k.wheel_vectors(v, d)]
    np.testing.assert_allclose(found, expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize("model", k.MODELS)
def test_forward_undoes_inverse_on_slip_free_motion(model):
    rng = np.random.default_rng(1)
    geometry = random_geometry(rng) if model != "paper" else CAD
    twists = rng.uniform(-0.3, 0.3, (50, 3))
    speed, steering = k.inverse(geometry, twists)
    np.testing.assert_allclose(k.forward(geometry, speed, steering, model), twists, atol=1e-9)


def test_the_papers_model_errs_on_an_asymmetric_robot_as_measured():
    """Published FM geometry at |v| <= 0.2 m/s, |w| <= 1 rad/s (arXiv 2509.04016)."""
    fm = k.WheelGeometry(
        np.array([0.1181, -0.1181, -0.1164, 0.1124]),
        np.array([0.1069, 0.1181, -0.1071, -0.1069]),
        np.array([0.02555, 0.02667, 0.02591, 0.02511]),
    )
    corners = np.array([(a, b, w) for a in (-0.2, 0, 0.2) for b in (-0.2, 0, 0.2) for w in (-1.0, 0, 1.0)])
    speed, steering = k.inverse(fm, corners)
    error = np.abs(k.forward(fm, speed, steering, "paper") - corners).max(axis=0)
    assert 0.005 < error[2] < 0.06
    assert 0.0005 < error[:2].max() < 0.006
    np.testing.assert_allclose(k.forward(fm, speed, steering), corners, atol=1e-12)


def test_bad_geometry_is_refused_by_name():
    with pytest.raises(UsageError, match="radii"):
        k.WheelGeometry(CAD.x_m, CAD.y_m, -CAD.radius_m)
    with pytest.raises(UsageError, match="four finite"):
        k.WheelGeometry(np.zeros(3), CAD.y_m, CAD.radius_m)
    with pytest.raises(UsageError, match="loads"):
        k.WheelGeometry(CAD.x_m, CAD.y_m, CAD.radius_m, load=[1.0, 1.0, 1.0, -0.1])
    with pytest.raises(UsageError, match="one point"):
        k.WheelGeometry(np.zeros(4), np.zeros(4), CAD.radius_m)
    with pytest.raises(UsageError, match="expected one of exact"):
        k.forward(CAD, np.ones(4), np.zeros(4), "wishful")
    with pytest.raises(UsageError, match="integrator"):
        o.integrate(np.zeros(3), np.zeros((1, 3)), "midpoint")


def test_exponential_integration_composes_group_elements():
    steps = 0.1 * np.random.default_rng(5).standard_normal((30, 3))
    pose = np.array([0.2, -0.1, 0.4])
    path = o.integrate(pose, steps)
    for step, expected in zip(steps, path[1:], strict=True):
        pose = compose(pose, se2_exp(step))
        np.testing.assert_allclose(pose, expected, atol=1e-12)


def test_euler_converges_to_the_exponential_at_first_order():
    ends = []
    for n in (100, 200, 400):
        step = np.tile([0.5 / n, 0.1 / n, 1.0 / n], (n, 1))
        gap = o.integrate(np.zeros(3), step, "euler")[-1] - o.integrate(np.zeros(3), step)[-1]
        ends.append(np.linalg.norm(gap))
    assert ends[0] / ends[1] == pytest.approx(2.0, rel=0.02)
    assert ends[1] / ends[2] == pytest.approx(2.0, rel=0.02)


def test_integration_jacobian_matches_differences():
    rng = np.random.default_rng(6)
    motion, slope = 0.05 * rng.standard_normal((20, 3)), rng.standard_normal((3, 2, 20))
    start = rng.standard_normal(3)
    poses, jacobian = o.integrate_with_jacobian(start, motion, slope)
    np.testing.assert_allclose(poses, o.integrate(start, motion), atol=1e-13)
    for j in range(2):
        up = o.integrate(start, motion + 1e-6 * slope[:, j].T)
        down = o.integrate(start, motion - 1e-6 * slope[:, j].T)
        np.testing.assert_allclose(jacobian[:, j].T, ((up - down) / 2e-6)[1:], atol=1e-7)


def test_several_paths_are_integrated_as_each_by_itself():
    rng = np.random.default_rng(8)
    motion, slope = 0.05 * rng.standard_normal((4, 20, 3)), rng.standard_normal((3, 2, 4, 20))
    start = rng.standard_normal((4, 3))
    poses, jacobian = o.integrate_with_jacobian(start, motion, slope)
    for one in range(4):
        own = o.integrate_with_jacobian(start[one], motion[one], slope[:, :, one])
        np.testing.assert_allclose(poses[one], own[0], atol=1e-13)
        np.testing.assert_allclose(jacobian[:, :, one], own[1], atol=1e-13)
        euler = o.integrate(start[one], motion[one], "euler")
        np.testing.assert_allclose(o.integrate(start, motion, "euler")[one], euler, atol=1e-13)


@pytest.mark.parametrize("model", ["exact", "paper"])
def test_state_space_model_and_its_jacobians(model):
    rng = np.random.default_rng(7)
    geometry = random_geometry(rng)
    state, inputs = rng.standard_normal(11), rng.standard_normal(8)
    rate = o.state_derivative(geometry, state, inputs, model)
    np.testing.assert_allclose(rate[3:7], inputs[:4] / geometry.radius_m)
    np.testing.assert_allclose(rate[7:], inputs[4:])
    by_state, by_input = (
        o.state_jacobian(geometry, state, inputs, model),
        o.input_jacobian(geometry, state, model),
    )
    np.testing.assert_allclose(by_input @ inputs, rate, atol=1e-12)
    for i in range(11):
        h = 1e-6 * np.eye(11)[i]
        slope = (
            o.state_derivative(geometry, state + h, inputs, model)
            - o.state_derivative(geometry, state - h, inputs, model)
        ) / 2e-6
        np.testing.assert_allclose(by_state[:, i], slope, atol=1e-8)
