"""Lines on the wall with odometry in the loop: short, sagging and turned, as much as the facts say."""

import math
from functools import cache

import numpy as np
import pytest
from plant_driving import FLOOR, X_LINE, Y_LINE, build, track

from hil.robot.trajectories import line

MM, DEG = 1e3, math.degrees(1.0)
SHORT = line((0, 0, 0), (0.5, 0, 0), duration_s=10.0)


@cache
def x_line(surface):
    """Truth, odometry and reference of the X line on a surface."""
    return track(build(surface=surface), X_LINE)


@pytest.mark.parametrize(
    ("trajectory", "along", "expected"),
    [(X_LINE, 0, [-57.5, -40.1, -2.4]), (Y_LINE, 1, [-35.5, -4.6, -3.0])],
    ids=["x", "y"],
)
def test_end_errors_are_of_the_size_of_the_facts(trajectory, along, expected):
    """Independent simulation: melamine, 45 N, compensation 0.7, 1.5 m in 30 s."""
    truth, odometry, wanted = x_line("melamine") if along == 0 else track(build(), trajectory)
    end = (truth[-1] - wanted[-1]) * [MM, MM, DEG]
    np.testing.assert_allclose(end, expected, atol=12.0)
    assert end[2] == pytest.approx(expected[2], abs=1.0)
    believed = np.abs(odometry[-1] - wanted[-1])
    assert believed[:2].max() < 2e-3
    assert np.all(np.diff(truth[50:, along]) > -1e-4)


def test_the_floor_needs_no_correction():
    truth, _, wanted = track(build(**FLOOR), SHORT)
    assert np.abs(truth - wanted)[-1, :2].max() < 2e-3 / 3.0


def test_friction_decides_how_far_it_slips():
    lost = []
    for surface in ("concrete", "melamine"):
        truth, _, wanted = track(build(surface=surface), SHORT)
        lost.append(3.0 * (wanted[-1, 0] - truth[-1, 0]))
    assert 0.005 < lost[0] < 0.85 * lost[1]


def test_a_slippery_band_costs_way_and_no_more():
    plain, patchy = (x_line(surface)[0][-1] for surface in ("melamine", "patchy"))
    assert -0.1 < patchy[0] - plain[0] < -1e-3
