"""Clocks of wheels and ground truth that differ are reported; those of the real recordings do not."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.synthetic import OTHER_MOTIONS, hidden_robot, make_set
from hil.calibration.warnings import warnings_of
from hil.cli import main
from hil.datasets.plain_csv import write_plain
from hil.datasets.time_offset import different_clocks, time_offset_s


@pytest.fixture(scope="module")
def data():
    return make_set(hidden_robot(2, contact="elastic"), 2, repetitions=1)


def late(one, by_s):
    return replace(one, truth_t_s=one.truth_t_s + by_s)


@pytest.mark.parametrize("by_s", [-0.6, -0.2, 0.06, 0.2])
def test_an_offset_is_measured_to_hundredths_of_a_second(data, by_s):
    found = [time_offset_s(late(one, by_s)) for one in data]
    assert found == pytest.approx([by_s] * len(data), abs=0.03)
    (line,) = warnings_of([late(one, by_s) for one in data])
    assert f"moves {abs(by_s):.2f} s {'later' if by_s > 0 else 'earlier'} than the wheels" in line


def test_clocks_that_agree_are_not_mentioned(data):
    others = make_set(hidden_robot(3, contact="coulomb"), 3, OTHER_MOTIONS, 2, corrupted="arc_1")
    for one in (*data, *others):
        assert time_offset_s(one) == pytest.approx(0.0, abs=0.03)
    assert warnings_of(data) == different_clocks(others) == []


def test_a_robot_that_never_rests_or_never_moves_reports_nothing(data):
    steady = data[0]
    inside = (steady.t_s > 5.0) & (steady.t_s < 15.0)
    cut = replace(
        steady,
        t_s=steady.t_s[inside],
        wheel_angle_rad=steady.wheel_angle_rad[inside],
        steering_rad=steady.steering_rad[inside],
    )
    still = replace(steady, wheel_angle_rad=np.zeros_like(steady.wheel_angle_rad))
    assert different_clocks([late(cut, 0.2)]) == different_clocks([still]) == []


@pytest.mark.parametrize("way", [0.01, 1.0, 100.0], ids=["slow", "as it is", "fast"])
def test_speeds_that_are_not_alike_tell_nothing_however_fast(data, way):
    """Wheels that roll in one second of twenty, and ground truth that moves all the time."""
    one = data[0]
    t_s = np.arange(0.0, 20.0, 0.01)
    rolled = way * np.clip(t_s - 9.0, 0.0, 1.0)
    pose = way * np.column_stack([0.05 * t_s, 0.02 * np.sin(5.0 * t_s), np.zeros_like(t_s)])
    apart = replace(
        one,
        t_s=t_s,
        wheel_angle_rad=np.outer(rolled, np.ones(4)),
        steering_rad=np.zeros((len(t_s), 4)),
        truth_t_s=t_s,
        truth_pose=pose,
    )
    assert time_offset_s(apart) is None


def test_evaluate_says_so(tmp_path, capsys, data):
    write_plain(tmp_path / "line_x_1.csv", late(data[0], 0.2))
    assert main(["evaluate", str(tmp_path)]) == 0
    assert "the ground truth moves 0.20 s later than the wheels" in capsys.readouterr().err


def slow(one, by_s, period_s):
    """Ground truth of a clock that is late, thinned to one row in a period."""
    every = round(period_s / float(np.median(np.diff(one.truth_t_s))))
    rows = slice(every // 3, None, every)
    return replace(
        one,
        truth_t_s=one.truth_t_s[rows] + by_s,
        truth_pose=one.truth_pose[rows],
        truth_receive_s=one.truth_receive_s[rows],
    )


@pytest.mark.parametrize("period_s", [0.2, 0.4, 1.0])
def test_ground_truth_at_a_low_rate_is_no_other_clock(data, period_s):
    for one in data:
        assert time_offset_s(slow(one, 0.0, period_s)) == pytest.approx(0.0, abs=0.03 + 0.1 * period_s)
        assert different_clocks([slow(one, 0.0, period_s)]) == []


@pytest.mark.parametrize("period_s", [0.2, 1.0])
def test_a_late_clock_shows_at_a_low_rate_too(data, period_s):
    (line,) = different_clocks([slow(one, 0.3, period_s) for one in data])
    assert "the ground truth moves 0.3" in line or "the ground truth moves 0.29" in line
    assert "later" in line
