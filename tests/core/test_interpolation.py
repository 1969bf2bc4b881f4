"""Motion capture at the cycle times: a value only where samples are near."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from hil.core.interpolation import between_samples
from hil.core.signals import RobotState
from hil.loop.driven_motion import HELD_S, LONGEST_GAP_S, Motion

AT_REST = RobotState(0, np.zeros(3), np.zeros(3), np.eye(6))


def motion(at_s, until_s, cycle_s=0.02):
    """Samples at `at_s` of a body that goes 1 m/s, cycles until `until_s`."""
    found = [
        SimpleNamespace(
            valid=True, stamp=SimpleNamespace(t_ns=round(1e9 * t)), pose=np.array([t, -t, 0.1 * t])
        )
        for t in at_s
    ]
    cycles = np.arange(0.0, until_s + 1e-9, cycle_s)
    records = [
        SimpleNamespace(
            inputs=SimpleNamespace(t_ns=round(1e9 * t)),
            measurements=SimpleNamespace(mocap=tuple(found) if k == 0 else (), wheels=()),
            state=AT_REST,
            reference=None,
            observers={},
            events=(),
        )
        for k, t in enumerate(cycles)
    ]
    return Motion(tuple(records))


def test_motion_capture_that_ends_early_says_nothing_of_the_end():
    seen = motion(np.arange(0.0, 1.0001, 0.01), 3.0)
    known = np.isfinite(seen.mocap).all(axis=1)
    assert seen.t_s[known][-1] == pytest.approx(1.0 + HELD_S)
    assert np.isnan(seen.mocap[-1]).all()
    np.testing.assert_allclose(seen.mocap[known & (seen.t_s <= 1.0), 0], seen.t_s[known & (seen.t_s <= 1.0)])
    assert (seen.mocap[known & (seen.t_s > 1.0), 0] == 1.0).all()


@pytest.mark.parametrize(
    ("gap_s", "bridged"), [(0.21, True), (LONGEST_GAP_S, True), (0.3, False), (1.0, False)]
)
def test_only_gaps_that_sound_capture_systems_have_are_interpolated(gap_s, bridged):
    at_s = np.concatenate([np.arange(0.0, 1.0001, 0.01), np.arange(1.0 + gap_s, 2.5, 0.01)])
    seen = motion(at_s, 2.4)
    inside = (seen.t_s > 1.001) & (seen.t_s < 0.999 + gap_s)
    assert np.isfinite(seen.mocap[inside]).all() == bridged
    assert np.isfinite(seen.mocap[~inside]).all()
    assert np.isnan(seen.mocap[inside]).all() != bridged


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_samples_are_no_path(count):
    assert np.isnan(motion(np.arange(count), 0.1).mocap).all()
    assert motion(np.arange(count), 0.1).mocap.shape == (6, 3)


def test_samples_are_met_and_what_is_outside_them_is_not():
    t, values = np.array([0.0, 1.0, 1.0, 5.0]), np.array([[0.0], [1.0], [1.0], [5.0]])
    at = np.array([-0.2, -0.1, 0.0, 0.5, 1.0, 1.1, 4.9, 5.0, 5.2, 5.3])
    found = between_samples(at, t, values, longest=1.0, before=0.1, after=0.2)[:, 0]
    wanted = [math.nan, 0.0, 0.0, 0.5, 1.0, math.nan, math.nan, 5.0, 5.0, math.nan]
    np.testing.assert_array_equal(found, wanted)
