"""Laws of the plane and of rotations."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core import geometry as g

number = st.floats(-3, 3)
pose = st.tuples(number, number, number)


@given(st.floats(-1e3, 1e3))
def test_wrap_stays_in_the_half_open_turn_and_keeps_the_angle(angle):
    wrapped = g.wrap(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)


def test_wrap_array_keeps_nan():
    assert np.isnan(g.wrap_array([np.nan, 1.0])[0])
    assert g.wrap_array([3 * math.pi])[0] == pytest.approx(math.pi)


@given(pose)
def test_log_undoes_exp(delta):
    np.testing.assert_allclose(g.se2_log(g.se2_exp(delta)), delta, atol=1e-9)


@given(pose, number)
def test_exp_of_one_twist_is_a_one_parameter_group(delta, k):
    delta = np.asarray(delta)
    both = g.compose(g.se2_exp(delta), g.se2_exp(k * delta))
    np.testing.assert_allclose(both, g.se2_exp((1 + k) * delta), atol=1e-9)


@given(st.floats(0.5e-4, 2e-4))
def test_series_and_closed_form_meet(angle):
    exact = np.array([math.sin(angle) / angle, (1 - math.cos(angle)) / angle, angle])
    np.testing.assert_allclose(g.se2_exp([1.0, 0.0, angle]), exact, atol=1e-11)


@given(pose, pose, pose)
def test_compose_is_a_group(a, b, c):
    np.testing.assert_allclose(g.compose(g.compose(a, b), c), g.compose(a, g.compose(b, c)), atol=1e-9)
    np.testing.assert_allclose(g.compose(a, g.inverse(a)), np.zeros(3), atol=1e-9)
    np.testing.assert_allclose(g.compose(a, g.between(a, b)), b, atol=1e-9)


@given(pose, pose, pose)
def test_quaternions_rotate_like_a_product_of_rotations(u, v, x):
    p, q = g.quat_from_rotvec(u), g.quat_from_rotvec(v)
    np.testing.assert_allclose(
        g.quat_rotate(g.quat_multiply(p, q), x), g.quat_rotate(p, g.quat_rotate(q, x)), atol=1e-9
    )
    np.testing.assert_allclose(g.quat_rotate(g.quat_conjugate(p), g.quat_rotate(p, x)), x, atol=1e-9)


@given(st.floats(-3.1, 3.1))
def test_yaw_of_a_yaw_quaternion_and_its_planar_rotation(yaw):
    q = g.quat_from_yaw(yaw)
    assert g.yaw_of_quat(q) == pytest.approx(yaw, abs=1e-12)
    np.testing.assert_allclose(g.quat_rotate(q, [1, 2, 0])[:2], g.rotation2(yaw) @ [1, 2], atol=1e-12)
