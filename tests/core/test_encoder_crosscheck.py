"""Injected horn slip is found again, and nothing is found where nothing is."""

import numpy as np
import pytest

from hil.config.encoders import EncodersConfig
from hil.core.signals import EncoderSample, Inputs, Measurements, Stamp, Status, WheelMeasurement
from hil.loop.checks.steering_encoders import CrossCheck, SteeringWatch


def steer(check, *, slip=0.0, play=0.0, config=None, noise=0.0):
    """Steps back and forth, resting at each end; slip comes in half-way."""
    rng = np.random.default_rng(0)
    config = config or EncodersConfig()
    result = None
    for turn in range(12):
        target = 0.4 if turn % 2 == 0 else -0.4
        start = -target if turn else 0.0
        for k in range(60):
            servo = start + (target - start) * min(1.0, k / 20)
            behind = servo + (0.5 * play if target < start else -0.5 * play)
            behind += slip if turn >= 6 else 0.0
            encoder = np.array([behind, servo, servo, servo]) + rng.normal(0, noise, 4)
            encoder = np.array(config.sign) * encoder + np.array(config.zeros_rad)
            result = check.update(encoder, np.full(4, servo))
    return result


def test_two_equal_angles_raise_no_alarm():
    result = steer(CrossCheck(EncodersConfig()), noise=0.001)
    assert result.horn_slip == (False,) * 4
    np.testing.assert_allclose(result.difference_rad, 0.0, atol=0.002)


@pytest.mark.parametrize("slip", [0.1, -0.25])
def test_horn_slip_is_measured_on_its_axis(slip):
    result = steer(CrossCheck(EncodersConfig()), slip=slip, noise=0.001)
    assert result.horn_slip == (True, False, False, False)
    assert result.difference_rad[0] == pytest.approx(slip, abs=0.003)


def test_backlash_is_no_horn_slip():
    result = steer(CrossCheck(EncodersConfig()), play=0.02, noise=0.0005)
    assert result.horn_slip == (False,) * 4


def test_mounting_sign_and_zero_are_taken_out():
    config = EncodersConfig(sign=(-1, 1, -1, 1), zero_rad=(3.0, -3.0, 0.2, 0.0))
    result = steer(CrossCheck(config), config=config)
    np.testing.assert_allclose(result.difference_rad, 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("zero_rad", "off_rad", "reported"),
    [(None, 0.5, False), ((0.0,) * 4, 0.5, True), ((0.0,) * 4, -0.2, True), ((0.0,) * 4, 0.1, False)],
)
def test_an_axis_that_is_far_off_from_the_start_is_reported_where_zeros_are_known(
    zero_rad, off_rad, reported
):
    """A servo's encoder that slipped while the bench was closed; zeros of a workshop are off by 0.05."""
    check = CrossCheck(EncodersConfig(zero_rad=zero_rad))
    for _ in range(20):
        result = check.update([off_rad, 0.0, 0.0, 0.0], [0.0] * 4)
    assert result.horn_slip == (reported, False, False, False)
    assert result.now_rad[0] == pytest.approx(off_rad if reported else 0.0, abs=1e-9)


def test_what_has_slipped_is_counted_from_what_was_learnt():
    check = CrossCheck(EncodersConfig())
    for k in range(60):
        result = check.update(np.full(4, 2.0 if k < 20 else 2.3), np.zeros(4))
    assert result.now_rad[0] == pytest.approx(0.3, abs=1e-9)
    assert result.difference_rad[0] == pytest.approx(0.3, abs=1e-3)


@pytest.mark.parametrize(("step_rad", "compared"), [(0.015, True), (0.02, False)])
def test_an_axis_that_still_turns_is_not_compared(step_rad, compared):
    """The two are not sampled at the same instant."""
    check = CrossCheck(EncodersConfig())
    for k in range(20):
        result = check.update(np.full(4, k * step_rad), np.full(4, k * step_rad))
    assert np.isfinite(result.difference_rad[0]) == compared


def test_nothing_is_claimed_before_it_is_known_or_from_missing_data():
    check = CrossCheck(EncodersConfig())
    nan = np.full(4, np.nan)
    for _ in range(50):
        result = check.update(nan, np.zeros(4))
    assert np.all(np.isnan(result.difference_rad))
    assert result.horn_slip == (False,) * 4
    for _ in range(50):
        result = check.update(np.array([0.5, np.nan, 0.5, 0.5]), np.array([0.0, 0.0, np.nan, 0.0]))
    assert np.isnan(result.difference_rad[1])
    assert np.isnan(result.difference_rad[2])
    assert result.difference_rad[0] == pytest.approx(0.0)


PERIOD_NS = 10_000_000


def watched(off_rad, *, servo=0.0, config=None, cycles=100, slips=((40, 10**6),)):
    """A steering watch that sees one axis off in stretches of cycles; events by cycle, stops by cycle."""
    config = config or EncodersConfig()
    watch, reported, stops = SteeringWatch(config, (5, 6, 7, 8)), [], []
    for k in range(cycles):
        off = np.array([0.0, off_rad if any(a <= k < b for a, b in slips) else 0.0, 0.0, 0.0])
        stamp, events = Stamp(k * PERIOD_NS, k * PERIOD_NS, k), []
        angle = np.mod(np.array(config.sign) * (servo + off) + np.array(config.zeros_rad) + np.pi, 2 * np.pi)
        sample = EncoderSample(stamp, angle - np.pi, (Status.OK,) * 4, (0,) * 4)
        wheels = WheelMeasurement(stamp, np.zeros(4), np.zeros(4), np.full(4, servo), (True,) * 4)
        inputs = Inputs(k, k * PERIOD_NS, encoders=(sample,))
        measured = Measurements(k, k * PERIOD_NS, wheels=(wheels,))
        watch.judge(inputs, measured, events, lambda *cause, k=k: stops.append((k, *cause)))
        reported += [(k, e) for e in events]
    return reported, stops


@pytest.mark.parametrize(
    ("servo", "config"), [(0.0, None), (3.1, None), (-3.1, EncodersConfig(zero_rad=(3.0,) * 4))]
)
def test_a_slip_is_reported_with_both_devices_and_then_stops(servo, config):
    reported, stops = watched(0.2, servo=servo, config=config)
    ((at, event),) = reported
    assert 40 <= at <= 55
    assert (event.level, event.source) == ("warning", "encoders")
    assert "wheel BL: its external encoder has moved +0.200 rad (+11.5 deg)" in event.message
    assert "servo steer_BL (ID 6)" in event.message
    first, reason, said = stops[0]
    assert at + 5 < first <= at + 15
    assert reason == "horn_slip"
    assert "+0.200 rad" in said


@pytest.mark.parametrize(
    ("off_rad", "reported", "stopped"),
    [(0.028, 0, False), (0.032, 1, False), (-0.058, 1, False), (-0.062, 1, True)],
)
def test_more_than_the_threshold_is_reported_and_twice_as_much_stops(off_rad, reported, stopped):
    events, stops = watched(off_rad, cycles=400)
    assert len(events) == reported
    assert bool(stops) is stopped


def test_a_quarter_of_a_second_is_enough_to_learn():
    reported, _ = watched(0.05, slips=((28, 10**6),))
    assert [e.message.count("+0.050 rad") for _, e in reported] == [1]


def test_a_slip_that_comes_again_is_reported_again():
    reported, _ = watched(0.05, cycles=400, slips=((40, 120), (280, 360)))
    assert [k // 200 for k, _ in reported] == [0, 1]


def test_without_one_of_the_two_nothing_is_compared():
    watch, events, stamp = SteeringWatch(EncodersConfig()), [], Stamp(0, 0, 0)
    outside = EncoderSample(stamp, np.full(4, 1.0), (Status.OK,) * 4, (0,) * 4)
    wheels = WheelMeasurement(stamp, np.zeros(4), np.zeros(4), np.zeros(4), (True,) * 4)
    for encoders in ((), (outside,)):
        for measured in ((), (wheels,))[: 2 - len(encoders)]:
            inputs = Inputs(0, 0, encoders=encoders)
            watch.judge(inputs, Measurements(0, 0, wheels=measured), events, pytest.fail)
    assert events == []


def test_angles_are_compared_every_50_ms_as_they_are_then():
    reported, _ = watched(0.5, slips=((41, 45),))
    assert reported == []
    reported, _ = watched(0.5, slips=((41, 47),))
    assert reported != []


def test_what_is_learnt_is_the_mean_of_the_first_five_pairs():
    check, offs = CrossCheck(EncodersConfig()), [3.13, -3.14, 3.14, 3.15, -3.13]
    for k, off in enumerate([9.0, *offs]):
        result = check.update(np.full(4, off), np.zeros(4))
        assert np.isnan(result.difference_rad[0]) == (k < len(offs))
    assert result.difference_rad[0] == pytest.approx(0.0, abs=1e-12)
    for _ in range(3):
        mean = np.mean([3.13, 2 * np.pi - 3.14, 3.14, 3.15, 2 * np.pi - 3.13])
        result = check.update(np.full(4, mean + 0.1), np.zeros(4))
    assert result.difference_rad[0] == pytest.approx(0.1 * (1.0 - 0.8**3), abs=1e-9)


def test_a_watch_that_was_reset_learns_anew():
    watch, events = SteeringWatch(EncodersConfig()), []
    for k in range(200):
        if k == 100:
            watch.reset()
        stamp, angle = Stamp(k * PERIOD_NS, k * PERIOD_NS, k), np.full(4, 0.3 if k >= 100 else 0.0)
        sample = EncoderSample(stamp, angle, (Status.OK,) * 4, (0,) * 4)
        wheels = WheelMeasurement(stamp, np.zeros(4), np.zeros(4), np.zeros(4), (True,) * 4)
        inputs, measured = Inputs(k, k * PERIOD_NS, encoders=(sample,)), Measurements(k, 0, wheels=(wheels,))
        watch.judge(inputs, measured, events, lambda *cause: pytest.fail(str(cause)))
    assert events == []
