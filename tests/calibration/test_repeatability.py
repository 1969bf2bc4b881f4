"""How far repetitions of one motion end apart: only those that go the same way are compared."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.cross_validation import repeatability
from hil.calibration.synthetic import hidden_robot, make_set


@pytest.fixture(scope="module")
def data():
    return make_set(hidden_robot(3), 3, ("line_x", "line_y", "circle_cw"), 3)


def back(one):
    """The same drive the other way: from the end of its ground truth to the begin."""
    return replace(one, truth_pose=one.truth_pose[::-1])


def test_ways_forth_and_back_do_not_mix(data):
    forth = repeatability(data)
    both = repeatability([*data, *(back(one) for one in data)])
    assert all(both[motion] == pytest.approx(forth[motion], rel=0.3) for motion in ("line_x", "line_y"))
    assert max(forth.values()) < 0.02
    assert np.isnan(repeatability([data[0], back(data[1]), data[6]])["line_x"])


def test_lines_of_other_lengths_do_not_mix(data):
    half = [replace(one, truth_pose=one.truth_pose[: len(one.truth_pose) // 2]) for one in data[:3]]
    assert repeatability([*data[:3], *half])["line_x"] < 0.02


def test_of_one_way_it_is_the_standard_deviation_of_the_ends(data):
    ends = []
    for one in data[3:6]:
        (x, y), heading = one.truth_pose[-1, :2] - one.truth_pose[0, :2], one.truth_pose[0, 2]
        ends.append((x + 1j * y) * np.exp(-1j * heading))
    spread = np.sqrt(np.var(np.real(ends), ddof=1) + np.var(np.imag(ends), ddof=1))
    assert repeatability(data)["line_y"] == pytest.approx(spread)
