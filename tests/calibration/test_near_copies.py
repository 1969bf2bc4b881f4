"""One drive in two recordings counts once, whatever was done to its rows; repetitions are no copies."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.synthetic import hidden_robot, make_set
from hil.datasets.near_copies import without_near_copies
from hil.datasets.plain_csv import write_plain
from hil.datasets.read import read_recordings
from hil.datasets.sampling import interpolate

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def data():
    return make_set(hidden_robot(4), 4, repetitions=3)


def noisy(one):
    rng = np.random.default_rng(1)
    pose, angle = (
        values + rng.normal(0.0, 1e-6, values.shape) for values in (one.truth_pose, one.wheel_angle_rad)
    )
    return replace(one, truth_pose=pose, wheel_angle_rad=angle)


def cut(one, by_s=0.43):
    """Without its ends, and with stamps that begin at 0."""
    begin_s, end_s = one.t_s[0] + by_s, one.t_s[-1] - by_s
    wheels, truth = ((t > begin_s) & (t < end_s) for t in (one.t_s, one.truth_t_s))
    return replace(
        one,
        t_s=one.t_s[wheels] - begin_s,
        wheel_angle_rad=one.wheel_angle_rad[wheels],
        steering_rad=one.steering_rad[wheels],
        wheel_rate_rad_s=one.wheel_rate_rad_s[wheels],
        truth_t_s=one.truth_t_s[truth] - begin_s,
        truth_pose=one.truth_pose[truth],
    )


def resampled(one, period_s=0.0137):
    at_s = np.arange(one.t_s[0] + 0.005, min(one.t_s[-1], one.truth_t_s[-1]), period_s)
    wheels = (one.wheel_angle_rad, one.steering_rad, one.wheel_rate_rad_s)
    angle, steering, rate = (interpolate(at_s, one.t_s, values) for values in wheels)
    return replace(
        one,
        t_s=at_s,
        wheel_angle_rad=angle,
        steering_rad=steering,
        wheel_rate_rad_s=rate,
        truth_t_s=at_s,
        truth_pose=interpolate(at_s, one.truth_t_s, one.truth_pose),
    )


@pytest.mark.parametrize("change", [noisy, cut, resampled, lambda one: resampled(cut(one))])
def test_a_changed_copy_is_left_out_and_named(data, change):
    more = [replace(change(one), name=f"again_{k}") for k, one in enumerate(data)]
    found = without_near_copies([*data, *more])
    assert len(found) == len(data)
    said = [what for one in found for what in one.repairs if "same drive" in what]
    assert len(said) == len(data)


def test_repetitions_are_no_copies(data):
    assert [one.name for one in without_near_copies(data)] == [one.name for one in data]


def test_the_copy_is_counted_when_files_are_read(data, tmp_path):
    for one in data[:2]:
        write_plain(tmp_path / f"{one.name}.csv", one)
    write_plain(tmp_path / "line_x_9.csv", cut(data[0]))
    found = read_recordings([tmp_path])
    assert [one.name for one in found] == ["line_x_1", "line_x_2"]
    assert any("line_x_9" in what for what in found[0].repairs)
