"""The clock mapping and the jump test by themselves."""

import math

import numpy as np
import pytest

from hil.fakes.tracker.true_parameters import IDEAL
from hil.streams.device_clock import DeviceClock
from hil.streams.pose_jumps import JumpTest

STILL = (1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("drift_ppm", "jitter_s"), [(0.0, 0.0), (-60.0, 0.002), (60.0, 0.01)])
def test_injected_latency_jitter_and_drift_are_taken_out(drift_ppm, jitter_s):
    rng = np.random.default_rng(3)
    clock = DeviceClock(latency_ns=20_000_000)
    errors = []
    for k in range(20_000):
        t_ns = 5_000_000 * k
        device_ns = round(1.6e18 + t_ns * (1.0 + 1e-6 * drift_ppm))
        late_ns = 20_000_000 + round(1e9 * jitter_s * rng.standard_exponential())
        mapped_ns, credible = clock.map(device_ns, t_ns + late_ns)
        assert credible
        errors.append(mapped_ns - t_ns)
    settled = np.array(errors[400:])
    assert np.max(np.abs(settled)) < 1e6
    assert abs(np.mean(settled)) < 0.5e6


def test_times_never_go_back_when_late_samples_are_found_out():
    """The first dozen arrives at once, because the host was busy; then all come promptly."""
    clock, period_ns = DeviceClock(latency_ns=0), 5_000_000
    mapped = []
    for k in range(40):
        arrival_ns = max(k * period_ns + 100_000, 55_000_000)
        mapped.append(clock.map(7_000_000 + k * period_ns, arrival_ns)[0])
    assert np.all(np.diff(mapped) > 0)
    assert mapped[-1] == pytest.approx(39 * period_ns + 100_000, abs=20_000)


def test_times_never_go_back_when_late_samples_were_followed_by_a_gap():
    """The first ten are 0.6 s late; what followed is lost; then all come promptly, in pairs."""
    clock, period_ns = DeviceClock(latency_ns=0), 5_000_000
    late = [(k, k * period_ns + 600_000_000) for k in range(10)]
    prompt = [(k, (k + k % 2) * period_ns + 100_000) for k in range(130, 200)]
    mapped = [clock.map(7_000_000 + k * period_ns, arrival_ns)[0] for k, arrival_ns in (*late, *prompt)]
    assert np.all(np.diff(mapped) > 0)
    assert mapped[-1] == pytest.approx(199 * period_ns + 100_000, abs=20_000)


def test_a_new_time_axis_is_taken_up_after_some_insistence():
    clock = DeviceClock(latency_ns=0)
    for k in range(100):
        clock.map(k * 5_000_000, k * 5_000_000)
    trusted = [clock.map(77_000_000_000 + k * 5_000_000, (100 + k) * 5_000_000)[1] for k in range(30)]
    assert trusted == [False] * 19 + [True] * 11
    assert clock.map(77_000_000_000 + 30 * 5_000_000, 130 * 5_000_000) == (130 * 5_000_000, True)


@pytest.mark.parametrize("ahead_ns", [3_000_000, 100_000_000, 240_000_000])
def test_one_wrong_stamp_makes_no_later_sample_look_late(ahead_ns):
    clock, period_ns = DeviceClock(latency_ns=0), 5_000_000
    for k in range(100):
        device_ns = k * period_ns + (ahead_ns if k == 50 else 0)
        mapped_ns, _ = clock.map(device_ns, k * period_ns + 1_000_000)
        assert mapped_ns == pytest.approx(k * period_ns + 1_000_000, abs=50_000)


def test_stamps_of_the_driver_are_the_time_of_exposure(tracker_bench, travelling_plant, follow):
    from dataclasses import replace

    plant = travelling_plant(twist=(0.5, 0.0, 0.0), start=(0, 0, 0))
    bench = tracker_bench(plant=plant, options=replace(IDEAL, jitter_s=0.003, clock_ppm=50.0))
    bench.driver.open()
    samples = follow(bench, 10.0)
    # Ideal poses at constant speed tell when they were taken, up to the instant of the first one.
    taken_s = np.array([np.linalg.norm(s.position_m) / 0.5 for s in samples]) + 0.3
    stamped_s = np.array([s.stamp.t_ns for s in samples]) * 1e-9
    assert np.max(np.abs(stamped_s - taken_s)[200:]) < 0.0005
    assert np.std(np.array([s.stamp.host_ns for s in samples]) * 1e-9 - taken_s) > 0.002


def jump_test(**changes):
    limits = {"distance_m": 0.03, "angle_rad": 0.05, "speed_m_s": 0.5, "rate_rad_s": 1.0, "reaccept_after": 5}
    return JumpTest(**{**limits, **changes})


def test_motion_is_no_jump_however_far_it_leads():
    test = jump_test()
    turn = [(math.cos(0.002 * k), 0.0, 0.0, math.sin(0.002 * k)) for k in range(2000)]
    assert not any(test.jumped(0.005 * k, (0.002 * k, 0.0, 0.0), turn[k]) for k in range(2000))


def test_one_outlier_costs_one_sample():
    test = jump_test()
    path = [0.0] * 5 + [1.0] + [0.0] * 5
    assert [test.jumped(0.005 * k, (x, 0.0, 0.0), STILL) for k, x in enumerate(path)] == [
        k == 5 for k in range(11)
    ]


def test_scattered_outliers_never_become_the_truth():
    test = jump_test()
    test.jumped(0.0, (0.0, 0.0, 0.0), STILL)
    assert all(test.jumped(0.005 * k, (1.0 + k % 7, 0.0, 0.0), STILL) for k in range(1, 100))


def test_a_turn_alone_is_a_jump_and_the_sign_of_a_quaternion_is_not():
    test = jump_test()
    test.jumped(0.0, (0.0, 0.0, 0.0), STILL)
    assert test.jumped(0.005, (0.0, 0.0, 0.0), (math.cos(0.1), 0.0, 0.0, math.sin(0.1)))
    assert not test.jumped(0.005, (0.0, 0.0, 0.0), (-1.0, 0.0, 0.0, 0.0))
    test.reset()
    assert not test.jumped(0.0, (9.0, 0.0, 0.0), STILL)
