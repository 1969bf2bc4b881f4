"""Contact laws against their own principles: least dissipation, balance of forces, scaling."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.estimator import wheel_friction
from hil.robot import contact_laws as law
from hil.robot.kinematics import WheelGeometry, forward_matrix, projection, twist_of_vectors, wheel_vectors
from hil.support.numba_jit import kernel
from tests.selected import draws

creep_twist, friction_twist = kernel(wheel_friction.creep_twist), kernel(wheel_friction.friction_twist)

CAD = WheelGeometry.nominal()
LOAD = np.array([0.5, 1.4, 1.5, 0.6])


def test_least_dissipation_is_a_minimum_and_ignores_one_contradicting_wheel():
    rng = np.random.default_rng(3)
    geometry = WheelGeometry.from_vector(CAD.vector() + 0.005 * rng.standard_normal(16))
    p = geometry.projection()
    twist = np.array([0.05, 0.02, 0.1])
    u = np.tile(p @ twist, (3, 1))
    u[1, 2] += 0.02
    u[2] += 0.004 * rng.standard_normal(8)
    b = law.least_dissipation(p, u)
    np.testing.assert_allclose(b[0], twist, atol=1e-9)
    np.testing.assert_allclose(b[1], twist, atol=1e-3)
    assert np.linalg.norm(twist_of_vectors(geometry, u[1:2])[0] - twist) > 5e-3
    z, columns, share = law.positions(p), u.T, np.ones(4)
    scale = law.rolled_mean(columns)
    best = law.dissipation(z, columns, tuple(b.T), scale, share, 1.0)
    for _ in range(40):
        other = b + 1e-4 * rng.standard_normal(b.shape)
        assert np.all(law.dissipation(z, columns, tuple(other.T), scale, share, 1.0) >= best - 1e-12)


def test_of_two_wheels_that_contradict_each_other_dry_friction_follows_the_loaded_one():
    """The front left wheel rolls 2 % too far, the one behind on the right 2 % too short."""
    u = CAD.projection() @ np.array([0.01, 0.0, 0.0])
    u[0], u[4] = 1.02 * u[0], 0.98 * u[4]

    def ahead(load):
        return twist_of_vectors(CAD.with_tyres(load, 1.0), u, "dry-friction")[0]

    assert ahead((1.0, 1.0, 1.0, 1.0)) == pytest.approx(0.01, abs=1e-9)
    assert ahead((1.7, 0.9, 0.5, 0.9)) > 0.01005
    assert ahead((0.5, 0.9, 1.7, 0.9)) < 0.00995


@given(st.floats(0.1, 10.0), st.integers(0, 100))
@draws(30)
def test_dry_friction_is_homogeneous(factor, seed):
    """Twice the wheel motion moves the body twice as far: Coulomb friction knows no speed."""
    u = 0.01 * np.random.default_rng(seed).standard_normal((4, 8))
    p = CAD.projection()
    np.testing.assert_allclose(
        law.least_dissipation(p, factor * u), factor * law.least_dissipation(p, u), atol=2e-6 * factor
    )


@pytest.mark.parametrize("power", [1.0, 1.2, 1.5, 2.0])
def test_dissipation_slopes_match_differences(power):
    rng = np.random.default_rng(4)
    z, u = law.positions(CAD.projection()), 0.01 * rng.standard_normal((8, 5))
    b, scale = 0.005 * rng.standard_normal((3, 5)), law.rolled_mean(u)

    def at(motion):
        (gx, gy, gt), h = law.dissipation_slopes(z, u, tuple(motion), scale, LOAD, power)
        hessian = np.array([[h[0], h[1], h[2]], [h[1], h[3], h[4]], [h[2], h[4], h[5]]])
        return law.dissipation(z, u, tuple(motion), scale, LOAD, power), np.array([gx, gy, gt]), hessian

    _, gradient, hessian = at(b)
    for axis in range(3):
        h = np.zeros((3, 1))
        h[axis] = 1e-7
        (up, up_slope, _), (down, down_slope, _) = at(b + h), at(b - h)
        np.testing.assert_allclose(hessian[axis], (up_slope - down_slope) / 2e-7, rtol=2e-3, atol=1e-4)
        np.testing.assert_allclose(gradient[axis] / scale**2, (up - down) / 2e-7, rtol=1e-3, atol=1e-2)


def test_one_row_and_many_are_read_alike():
    """numba runs the laws on numbers, numpy on arrays: every step is the same, and so is what comes out."""
    z, u = law.positions(CAD.projection()), contradicting(np.random.default_rng(8)).T.copy()
    scale = law.rolled_mean(u)
    many = law.polished(z, u, law.continued(z, u, scale, LOAD, 1.0), scale, LOAD, 1.0)
    for k, one in enumerate(u.T):
        size = law.rolled_mean(one)
        alone = law.polished(z, one, law.continued(z, one, size, LOAD, 1.0), size, LOAD, 1.0)
        np.testing.assert_allclose(np.array(alone), np.array(many)[:, k], rtol=1e-9, atol=1e-15)
        creeping = law.creep_balance(z, one, size, LOAD, 0.7)[0]
        np.testing.assert_allclose(law.creep_motion(CAD.projection(), one[None], LOAD, 0.7)[0], creeping)


def contradicting(rng, n=6):
    """Wheel vectors of body motions, wheel headings off by up to two degrees and lengths by 2 %."""
    u = 0.002 * rng.standard_normal((n, 3)) @ np.diag([1, 1, 5]) @ CAD.projection().T
    size, heading = np.hypot(u[:, 0::2], u[:, 1::2]), np.arctan2(u[:, 1::2], u[:, 0::2])
    error = rng.uniform(-1, 1, (2, n, 4))
    return wheel_vectors(size * (1 + 0.02 * error[0]), heading + 0.035 * error[1])


def test_creep_forces_balance():
    """Force = load times slip over way rolled, softer sideways; no net force and no net torque."""
    u, p = contradicting(np.random.default_rng(5)), CAD.projection()
    b = law.creep_motion(p, u, LOAD, 0.7)
    slip = (u - b @ p.T).reshape(-1, 4, 2)
    rolled = np.linalg.norm(u.reshape(-1, 4, 2), axis=2)
    along = u.reshape(-1, 4, 2) / rolled[..., None]
    across = along[..., ::-1] * [-1, 1]
    force = (
        sum(
            stiffness * np.sum(slip * axis, axis=2)[..., None] * axis
            for stiffness, axis in ((1.0, along), (0.7, across))
        )
        * (LOAD / rolled)[..., None]
    )
    torque = CAD.x_m * force[..., 1] - CAD.y_m * force[..., 0]
    scale = np.abs(force).sum(axis=(1, 2))
    assert np.abs(slip).max() > 1e-5
    np.testing.assert_allclose(force.sum(axis=1) / scale[:, None], 0.0, atol=1e-12)
    np.testing.assert_allclose(torque.sum(axis=1) / scale, 0.0, atol=1e-12)


def test_creep_of_equal_tyres_that_roll_alike_is_least_squares():
    rng = np.random.default_rng(6)
    u = wheel_vectors(
        np.full((5, 4), 0.01), rng.uniform(-np.pi, np.pi, (5, 1)) + 0.03 * rng.standard_normal((5, 4))
    )
    exact = u @ forward_matrix(CAD.x_m, CAD.y_m).T
    np.testing.assert_allclose(law.creep_motion(CAD.projection(), u, np.ones(4), 1.0), exact, atol=1e-12)


@given(st.floats(0.05, 20.0), st.integers(0, 100))
@draws(30)
def test_creep_knows_neither_speed_nor_weight(factor, seed):
    u, p = contradicting(np.random.default_rng(seed)), CAD.projection()
    b = law.creep_motion(p, u, LOAD, 0.7)
    np.testing.assert_allclose(law.creep_motion(p, factor * u, LOAD, 0.7), factor * b, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(law.creep_motion(p, u, factor * LOAD, 0.7), b, rtol=1e-9, atol=1e-15)


def test_a_robot_that_stands_does_not_move():
    assert not np.any(law.creep_motion(CAD.projection(), np.zeros((2, 8)), LOAD, 0.7))


@pytest.mark.parametrize(
    "geometry", [CAD, WheelGeometry(CAD.x_m, CAD.y_m, CAD.radius_m, load=LOAD, creep_ratio=0.7)]
)
def test_filter_kernels_follow_the_same_laws(geometry):
    """The window of the last steps decides the weights; with one step in it both forms are one law."""
    wheels, p = wheel_friction.contacts(geometry)[0], projection(geometry.x_m, geometry.y_m)
    for u in contradicting(np.random.default_rng(7)):
        want = law.creep_motion(p, u[None], geometry.load, geometry.creep_ratio)[0]
        np.testing.assert_allclose(creep_twist(u, u, wheels), want, rtol=1e-6, atol=1e-12)
        want = law.least_dissipation(p, u[None], geometry.load)[0]
        np.testing.assert_allclose(friction_twist(u, u, wheels), want, rtol=0.02, atol=1e-5)
