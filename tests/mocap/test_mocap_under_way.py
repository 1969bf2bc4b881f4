"""Motion capture that is late and noisy under way: what was put in is recovered from the driver's samples."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.datasets.sequence_times import on_period
from hil.fakes.mocap.natnet.true_parameters import STILL

RATE_HZ = 64.0


def seen(bench, watch, duration_s=60.0):
    """Stamps and arrivals (n,), s, numbers (n,), places (n, 2), m, and headings (n,), rad."""
    bench.driver.open()
    samples = watch(bench, duration_s)[64:]
    stamps = np.array([s.stamp.t_ns for s in samples]) * 1e-9
    heading = np.unwrap([2.0 * math.atan2(s.quaternion_wxyz[3], s.quaternion_wxyz[0]) for s in samples])
    numbers = np.array([s.stamp.seq for s in samples], dtype=float)
    return stamps, numbers, np.array([s.position_m[:2] for s in samples]), heading


def test_late_stamps_have_their_lateness_and_numbers_give_the_times_back(mocap_bench, watch, climber):
    late = replace(STILL, rate_hz=RATE_HZ, stamp_late_s=0.01)
    bench = mocap_bench(options=late, plant=climber(velocity=(0.3, 0.0), rate=0.0))
    stamps, numbers, places, _ = seen(bench, watch)
    true_s = (places[:, 0] - bench.plant.start[0]) / 0.3
    assert np.diff(true_s).min() == pytest.approx(1.0 / RATE_HZ, abs=1e-5)
    behind = stamps - true_s
    assert np.all(np.diff(stamps) > 0.0)
    late_s, draws = np.zeros(20_000), np.random.default_rng(7).exponential(0.01, 20_000)
    for k in range(1, len(late_s)):
        late_s[k] = max(draws[k], late_s[k - 1] - 1.0 / RATE_HZ)  # frames leave in their order
    assert np.std(behind) == pytest.approx(np.std(late_s), rel=0.1)
    regular = on_period(stamps, numbers) - true_s
    assert np.std(regular) < 0.05 * np.std(behind)


def test_noise_under_way_has_its_size_and_rests_with_the_body(mocap_bench, watch, climber):
    noisy = replace(STILL, rate_hz=RATE_HZ, moving_angle_noise_rad=5e-4, exposure_jitter_s=7e-4)
    ahead = climber(velocity=(0.2, 0.0), start=(0.0, 0.0, 0.0), rate=0.0)
    bench = mocap_bench(options=noisy, plant=ahead)
    stamps, _, places, heading = seen(bench, watch)
    along = places[:, 0] - np.polynomial.Polynomial.fit(stamps, places[:, 0], 1)(stamps)
    assert np.std(heading) == pytest.approx(5e-4, rel=0.1)
    assert np.std(along) == pytest.approx(0.2 * 7e-4, rel=0.1)
    assert np.std(places[:, 1]) < 1e-6
    x = 1.0 / RATE_HZ / noisy.moving_noise_s
    turned = heading - np.mean(heading)
    found = np.mean(turned[1:] * turned[:-1]) / np.mean(turned**2)
    assert found == pytest.approx((1.0 + x) * math.exp(-x), abs=0.05)
    shivers = replace(noisy, position_noise_m=1e-6)  # a driver takes equal frames for repeated ones
    still = mocap_bench(options=shivers, plant=climber(velocity=(0.0, 0.0), rate=0.0))
    _, _, places, heading = seen(still, watch, 5.0)
    assert np.ptp(heading) < 1e-6
    assert np.std(places, axis=0) == pytest.approx(1e-6, rel=0.2)
