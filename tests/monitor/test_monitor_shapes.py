"""Geometry of the wall view, by its laws."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.core.geometry import compose
from hil.monitor.plane_geometry import (
    Trail,
    body_outline,
    covariance_ellipse,
    place,
    speed_arrows,
    to_view,
    wheel_segments,
)
from hil.robot.kinematics import WheelGeometry

GEOMETRY = WheelGeometry.nominal()
POSE = np.array([1.2, -0.4, 0.3])


def test_up_the_wall_is_up_on_the_screen_and_left_is_left():
    right, down = to_view(np.array([[1.0, 0.0]]))[0]
    assert (right, down) == (0.0, -1.0)
    right, down = to_view(np.array([[0.0, 1.0]]))[0]
    assert (right, down) == (-1.0, 0.0)


def test_placing_agrees_with_composition_of_poses():
    points = np.array([[0.1, 0.2], [-0.3, 0.05]])
    expected = [compose(POSE, [x, y, 0.0])[:2] for x, y in points]
    np.testing.assert_allclose(place(POSE, points), expected, atol=1e-15)


def test_outline_is_closed_and_keeps_its_size_wherever_it_is():
    here, there = body_outline(np.zeros(3), GEOMETRY), body_outline(POSE, GEOMETRY)
    assert np.allclose(here[0], here[-1])
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(here, axis=0), axis=1), np.linalg.norm(np.diff(there, axis=0), axis=1)
    )


def test_wheels_are_two_radii_long_and_point_where_they_steer():
    steering = np.array([0.0, 0.5, -0.5, 1.5])
    segments = wheel_segments(POSE, steering, GEOMETRY)
    along = segments[:, 1] - segments[:, 0]
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), 2 * GEOMETRY.radius_m)
    np.testing.assert_allclose(np.arctan2(along[:, 1], along[:, 0]), steering + POSE[2])


def test_arrows_are_one_second_of_travel():
    rate = np.array([1.0, 2.0, -1.0, 0.0])
    origins, vectors = speed_arrows(POSE, np.zeros(4), rate, GEOMETRY)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), np.abs(rate) * GEOMETRY.radius_m)
    centre = wheel_segments(POSE, np.zeros(4), GEOMETRY).mean(axis=1)
    np.testing.assert_allclose(origins, centre, atol=1e-15)


def test_ellipse_holds_95_percent_of_the_positions():
    covariance = np.array([[4e-4, 1e-4, 0], [1e-4, 1e-4, 0], [0, 0, 1e-3]])
    outline = covariance_ellipse(POSE, covariance) - POSE[:2]
    distance = np.einsum("ni,ij,nj->n", outline, np.linalg.inv(covariance[:2, :2]), outline)
    np.testing.assert_allclose(distance, -2.0 * math.log(0.05))


def test_a_trail_is_bounded_and_keeps_its_extent():
    trail = Trail(capacity=50, spacing_m=0.001)
    for k in range(5000):
        trail.add(0.002 * k, 0.0)
        assert len(trail.points()) <= 50
    points = trail.points()
    assert points[0, 0] == 0.0
    assert points[-1, 0] == pytest.approx(10.0, rel=0.1)


def test_a_trail_leaves_out_rest_and_nan():
    trail = Trail()
    for value in (0.0, 0.0001, math.nan, 0.5):
        trail.add(value, 0.0)
    assert trail.points().tolist() == [[0.0, 0.0], [0.5, 0.0]]
