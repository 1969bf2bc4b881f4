"""Ground truth that leaves the plane in which wheels roll has another axis up, or a tilted frame."""

import numpy as np
import pytest

from hil.core.errors import DataError
from hil.core.geometry import quat_multiply, quat_rotate
from hil.datasets.truth_plane import check_plane

Y_UP = (np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0)
"""Turns a frame with z up into one with y up."""


def tilt(by_rad):
    return (np.cos(0.5 * by_rad), np.sin(0.5 * by_rad), 0.0, 0.0)


def drive(motion, mount=(1.0, 0.0, 0.0, 0.0), seed=0):
    """Positions (n, 3) and quaternions (n, 4) of 2 m to the side, or of a turn, in another frame."""
    rng, t = np.random.default_rng(seed), np.linspace(0.0, 1.0, 500)
    yaw = 6.0 * t if motion == "turn" else 0.0 * t
    at = np.column_stack([0.0 * t, 0.0 * t if motion == "turn" else 2.0 * t, 0.0 * t])
    at += rng.normal(0.0, 1e-3, at.shape)
    turns = np.column_stack([np.cos(0.5 * yaw), 0.0 * t, 0.0 * t, np.sin(0.5 * yaw)])
    return np.array([quat_rotate(mount, p) for p in at]), np.array([quat_multiply(mount, q) for q in turns])


@pytest.mark.parametrize("motion", ["side", "turn"])
def test_a_frame_whose_y_axis_is_up_is_refused(motion):
    with pytest.raises(DataError, match=r"leaves the plane x, y") as raised:
        check_plane("a.csv", *drive(motion, Y_UP), 'up_axis is "z"')
    assert 'up_axis is "z"' in raised.value.remedy


def test_a_frame_tilted_by_ten_degrees_is_refused_and_one_by_two_is_not():
    check_plane("a.csv", *drive("side", tilt(np.radians(2.0))), "")
    with pytest.raises(DataError, match=r"z moves by 0\.3\d m"):
        check_plane("a.csv", *drive("side", tilt(np.radians(10.0))), "")


@pytest.mark.parametrize("motion", ["side", "turn"])
def test_a_body_set_up_at_any_angle_and_single_wrong_rows_pass(motion):
    position_m, wxyz = drive(motion)
    set_up = np.array([quat_multiply(q, tilt(2.0)) for q in wxyz])
    position_m[[3, 400]] += [0.0, 0.0, 5.0]
    set_up[[7, 300]] = [0.0, 1.0, 0.0, 0.0]
    check_plane("a.csv", position_m, set_up, "")
    check_plane("a.csv", position_m, wxyz, "")
