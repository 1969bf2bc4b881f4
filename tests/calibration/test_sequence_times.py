"""Sequence numbers give the sampling times of a periodic source whose stamps are late."""

import numpy as np
import pytest

from hil.datasets.public_csv import read_pair
from hil.datasets.sequence_times import on_period

PERIOD_S = 1.0 / 64.0


def source(rng, rows=3000, lost=0.3, late_s=0.06, drift=0.0):
    """True times (n,), stamps (n,) and numbers (n,) of messages, of which a share is lost."""
    number = np.flatnonzero(rng.random(rows) > lost).astype(np.float64)
    true_s = number * PERIOD_S * (1.0 + drift)
    return true_s, true_s + late_s * rng.random(len(number)) ** 2, number + 2014.0


@pytest.mark.parametrize("lost", [0.0, 0.3])
@pytest.mark.parametrize("drift", [0.0, 1e-4])
@pytest.mark.parametrize("late_s", [0.01, 0.03, 0.06])
def test_times_are_the_true_ones_up_to_a_constant(lost, drift, late_s):
    true_s, stamps_s, number = source(np.random.default_rng(1), lost=lost, late_s=late_s, drift=drift)
    off_s = on_period(stamps_s, number) - true_s
    assert np.std(off_s) < 0.1 * np.std(stamps_s - true_s)
    assert np.median(off_s) == pytest.approx(np.median(stamps_s - true_s), abs=2e-3)


def test_a_number_that_slips_by_one_costs_the_rows_beside_it():
    true_s, stamps_s, number = source(np.random.default_rng(2))
    number[1000:] -= 1.0
    number = number[np.flatnonzero(np.diff(number, prepend=-1.0) > 0.0)]
    true_s, stamps_s = true_s[: len(number)], stamps_s[: len(number)]
    off_s = on_period(stamps_s, number) - true_s
    assert np.std(off_s[:800]) < 2e-3
    assert np.std(off_s[1200:]) < 2e-3


def test_stamps_that_are_no_period_or_not_late_or_not_counted_stay():
    rng = np.random.default_rng(3)
    true_s, stamps_s, number = source(rng)
    at_random_s = np.cumsum(rng.exponential(PERIOD_S, len(number)))
    again = np.concatenate([number[:500], number[: len(number) - 500]])
    for stamps, numbers in (
        (true_s, number),
        (at_random_s, number),
        (stamps_s, again),
        (stamps_s[:300], number[:300]),
    ):
        assert on_period(stamps, numbers) is stamps


def test_the_truth_of_the_real_recordings_gets_quieter(public_data):
    """While the robot drives at constant speed, the second difference of its way is noise of time."""
    odom, absolute = (public_data / f"{name}_4.csv.gz" for name in ("odom", "abs"))
    one = read_pair(odom, absolute)
    assert any("sequence numbers" in note for note in one.notes)
    x_m, stamps_s = one.truth_pose[:, 0], one.truth_receive_s
    drives = (x_m > 0.5) & (x_m < 3.5)

    def noise_m(t_s):
        line = np.polyfit(t_s[drives], x_m[drives], 3)
        return float(np.std(np.diff(x_m[drives] - np.polyval(line, t_s[drives]))))

    assert noise_m(one.truth_t_s) < 0.5 * noise_m(stamps_s)
