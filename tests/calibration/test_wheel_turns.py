"""Whole turns of wheel angles: wraps are undone, gaps left alone, restarts and unknown turns refused."""

import numpy as np
import pytest

from hil.core.errors import DataError
from hil.datasets.cleaning import Log
from hil.datasets.wheel_log import build_recording
from hil.datasets.wheel_turns import BY_RATES, WRAPS

RADIUS_M, RATE_HZ, SPEED_RAD_S = 0.0254, 50.0, 3.15
GAP = "wheel gaps over 0.1 s bridged"


def drive(gap=None, *, rates=False, ahead_rad_s=SPEED_RAD_S, rate_hz=RATE_HZ):
    """Twelve seconds straight ahead between rests, without the wheel rows of a gap (begin, end), s."""
    t = np.arange(0.0, 14.0, 1.0 / rate_hz)
    rate = ahead_rad_s * np.clip(np.minimum(t - 1.0, 13.0 - t), 0.0, 1.0)
    rolled = np.cumsum(rate) / rate_hz
    angle = rolled[:, None] * [1.0, 1.01, 0.99, 1.005] + [0.3, -0.2, 0.1, 0.0]
    truth = np.column_stack([RADIUS_M * rolled, np.zeros_like(t), np.zeros_like(t)])
    keep = np.ones(len(t), dtype=bool) if gap is None else (t <= gap[0]) | (t >= gap[1])
    w = np.gradient(angle, t, axis=0) if rates else np.empty((len(t), 0))
    return t[keep], angle[keep], w[keep], Log(t, truth)


def read(t, angle, w, truth):
    wheels = Log(t, np.column_stack([angle, np.zeros((len(t), 4)), w]))
    return build_recording("run", wheels, truth, sources=("run.csv",))


def wrapped(angle):
    return np.angle(np.exp(1j * angle))


def same_way(recording, angle):
    np.testing.assert_allclose(recording.wheel_angle_rad - recording.wheel_angle_rad[0], angle - angle[0])


@pytest.mark.parametrize(("seconds", "sense"), [(0.5, 1.0), (1.1, -1.0), (3.0, 1.0)])
def test_angles_that_go_on_lose_no_turn_in_a_gap(seconds, sense):
    """They had lost one for every half turn: 1.1 s without rows made 3 mm into 123."""
    t, angle, w, truth = drive((5.0, 5.0 + seconds), ahead_rad_s=sense * SPEED_RAD_S)
    found = read(t, angle, w, truth)
    np.testing.assert_array_equal(found.wheel_angle_rad, angle)
    assert found.repairs == {GAP: 1}


def test_a_short_drive_within_one_turn_loses_none_either():
    t, angle, w, truth = drive((5.0, 6.9), ahead_rad_s=0.5)
    t, angle = t[t < 12.0], angle[t < 12.0]
    np.testing.assert_array_equal(read(t, angle, w[: len(t)], truth).wheel_angle_rad, angle)


def test_wheels_that_roll_more_than_half_a_turn_from_row_to_row_are_left_alone():
    t, angle, w, truth = drive(ahead_rad_s=12.0, rate_hz=3.0)
    found = read(t, angle, w, truth)
    np.testing.assert_array_equal(found.wheel_angle_rad, angle)
    assert WRAPS not in found.repairs


@pytest.mark.parametrize("fold", [wrapped, lambda angle: angle % (2.0 * np.pi)])
@pytest.mark.parametrize("gap", [None, (5.0, 5.5)])
def test_a_counter_that_wraps_at_a_turn_is_unwrapped(fold, gap):
    t, angle, w, truth = drive(gap)
    found = read(t, fold(angle), w, truth)
    same_way(found, angle)
    assert found.repairs[WRAPS] == np.count_nonzero(np.abs(np.diff(fold(angle), axis=0)) > np.pi)


def test_a_counter_of_many_turns_that_wraps_is_unwrapped():
    t, angle, w, truth = drive()
    folded = angle - 2.0 * np.pi * 512.0 * (angle > 20.0)
    found = read(t, folded, w, truth)
    same_way(found, angle)
    assert found.repairs == {WRAPS: 4}


def test_turns_in_a_gap_of_wrapped_angles_are_unknown():
    t, angle, w, truth = drive((5.0, 6.1))
    with pytest.raises(
        DataError,
        match=r"^run\.csv: the wheel angles \(phi1, phi2, phi3, phi4\) wrap .* for 1\.10 s, 5\.00 s after "
        r"its begin: .* unknown; expected rows at most 0\.6. s apart, or wheel rates",
    ):
        read(t, wrapped(angle), w, truth)


def test_wheel_rates_count_the_turns_in_a_gap():
    t, angle, w, truth = drive((5.0, 7.0), rates=True)
    found = read(t, wrapped(angle), w, truth)
    same_way(found, angle)
    assert found.repairs[BY_RATES] == 4


def test_wheel_rates_that_fit_no_number_of_turns_count_none():
    """The wheels rest in the gap for a part of it: half a turn is missing of what their rates promise."""
    t, angle, w, truth = drive((5.0, 7.0), rates=True)
    short = np.where(t[:, None] > 6.0, angle - np.pi, angle)
    with pytest.raises(DataError, match="how often the wheels turned meanwhile is unknown"):
        read(t, wrapped(short), w, truth)


@pytest.mark.parametrize("seconds", [3.0, 4.5, 6.0])
def test_wheel_rates_that_change_in_a_long_gap_count_no_turns(seconds):
    """The wheels stand before it and roll behind it, and it is unknown since when."""
    t, angle, w, truth = drive((0.5, 0.5 + seconds), rates=True)
    with pytest.raises(DataError, match="how often the wheels turned meanwhile is unknown"):
        read(t, wrapped(angle), w, truth)


def test_wrapped_wheels_that_stand_in_a_gap_have_not_turned():
    t, angle, w, truth = drive((0.1, 0.95))
    same_way(read(t, wrapped(angle), w, truth), angle)


@pytest.mark.parametrize("seconds", [0.02, 1.0])
@pytest.mark.parametrize("at_s", [3.0, 6.0])
def test_a_counter_that_starts_again_is_no_wrap(at_s, seconds):
    t, angle, w, truth = drive((at_s, at_s + seconds))
    k = np.searchsorted(t, at_s + 1e-9)
    again = np.vstack([angle[:k], angle[k:] - angle[k] + angle[0]])
    with pytest.raises(
        DataError, match=rf"phi\d leaps by -\d.* rad within .* s, {t[k - 1]:.2f} s after .* started"
    ):
        read(t, again, w, truth)


def test_a_counter_that_starts_again_after_whole_turns_is_no_wrap():
    """All four wheels are exactly where the recording began, two turns away."""
    t, angle, w, truth = drive()
    angle = np.repeat(angle[:, :1], 4, axis=1)
    k = int(np.searchsorted(angle[:, 0], angle[0, 0] + 4.0 * np.pi))
    with pytest.raises(DataError, match=r"phi1 leaps by -12\.\d* rad .* no wrap of its counter"):
        read(t, np.vstack([angle[:k], angle[k:] - angle[k] + angle[0]]), w, truth)


def test_one_damaged_angle_is_named():
    t, angle, w, truth = drive()
    angle[300, 2] += 50.0
    with pytest.raises(DataError, match=r"phi3 leaps by 50\.\d* rad within 0\.02 s, 5\.98 s after its begin"):
        read(t, angle, w, truth)


@pytest.mark.parametrize("leap", [3.0, -2.9, 0.6])
@pytest.mark.parametrize("rows", [slice(300, 301), slice(300, None)])
def test_a_leap_of_less_than_half_a_turn_is_named(leap, rows):
    t, angle, w, truth = drive(rates=True)
    angle[rows, 0] += leap
    with pytest.raises(DataError, match=r"phi1 leaps by .* rad within 0\.02 s, (5\.98|6\.00) s after"):
        read(t, angle, w, truth)


def test_an_angle_that_was_repeated_for_a_while_may_catch_up():
    t, angle, w, truth = drive()
    angle[300:345, 1] = angle[300, 1]
    np.testing.assert_array_equal(read(t, angle, w, truth).wheel_angle_rad, angle)


def steered(spoil):
    t, angle, _, truth = drive()
    steering = np.zeros((len(t), 4))
    spoil(t, steering)
    return build_recording("run", Log(t, np.column_stack([angle, steering])), truth, sources=("run.csv",))


@pytest.mark.parametrize("rows", [slice(300, 301), slice(300, 350)])
def test_steering_that_leaps_while_the_wheels_roll_is_named(rows):
    def spoil(t, steering):
        steering[rows, 2] += 1.5

    with pytest.raises(DataError, match=r"^run\.csv: .* delta3 leaps by 1\.50 rad within 0\.02 s, 5\.98 s"):
        steered(spoil)


def test_steering_may_leap_at_rest_or_as_one_turn_fast_or_wrap():
    def spoil(t, steering):
        steering[:] = (np.where(t < 0.5, 1.57, 0.0) - 1.57 * (t >= 6.0))[:, None]
        steering[:, 1] += 3.1 + 0.08 * np.sin(20.0 * t)
        steering[:, 1] = np.angle(np.exp(1j * steering[:, 1]))
        steering[:, 3] += np.interp(t, [0.0, 8.0, 8.2, 14.0], [0.0, 0.0, 1.5, 1.5])

    assert len(steered(spoil).t_s) == 700


def test_angles_in_degrees_are_named_for_their_unit_first():
    t, angle, w, truth = drive()
    with pytest.raises(DataError, match=r"\(phi\) seem to be in degrees"):
        read(t, np.degrees(angle) % 360.0, w, truth)
