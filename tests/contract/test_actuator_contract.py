"""What the servos promise, whoever answers on the wire."""

import numpy as np
import pytest

from hil.signals import ServoSetpoint

pytestmark = pytest.mark.moves


def hold(servos, bench, setpoint, duration_s):
    """Command a setpoint at the loop rate; the last sample."""
    period_ns = round(1e9 / bench.config.loop.rate_hz)
    next_ns, sample = bench.clock.now_ns(), None
    for _ in range(round(duration_s * bench.config.loop.rate_hz)):
        servos.command(setpoint)
        (sample,) = servos.read()
        next_ns += period_ns
        bench.clock.sleep_until_ns(next_ns)
    return sample


@pytest.fixture
def enabled(servos, bench):
    servos.enable()
    yield servos
    servos.stop()


def still(sample):
    return ServoSetpoint(np.zeros(4), sample.position_rad[4:].copy())


def test_enabling_moves_nothing(servos, bench):
    (before,) = servos.read()
    servos.enable()
    after = hold(servos, bench, still(before), 0.5)
    np.testing.assert_allclose(after.position_rad, before.position_rad, atol=0.02)


def test_goals_are_reached_with_their_sign(enabled, bench):
    (start,) = enabled.read()
    turned = ServoSetpoint(np.array([0.5, -0.5, 0.5, -0.5]), start.position_rad[4:] + [0.1, -0.1, 0.1, -0.1])
    sample = hold(enabled, bench, turned, 1.5)
    assert sample.ok
    np.testing.assert_allclose(sample.velocity_rad_s[:4], turned.drive_velocity_rad_s, atol=0.1)
    np.testing.assert_allclose(sample.position_rad[4:], turned.steer_position_rad, atol=0.03)
    moved = sample.position_rad[:4] - start.position_rad[:4]
    assert np.all(np.sign(moved) == np.sign(turned.drive_velocity_rad_s))
    back = hold(enabled, bench, still(start), 1.0)
    np.testing.assert_allclose(back.position_rad[4:], start.position_rad[4:], atol=0.03)


def test_stop_holds_the_steering_and_rests_the_wheels(enabled, bench):
    (start,) = enabled.read()
    hold(enabled, bench, ServoSetpoint(np.full(4, 1.0), start.position_rad[4:]), 0.5)
    enabled.stop()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 400_000_000)
    (resting,) = enabled.read()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 400_000_000)
    (later,) = enabled.read()
    np.testing.assert_allclose(later.position_rad, resting.position_rad, atol=0.01)
    np.testing.assert_allclose(later.position_rad[4:], start.position_rad[4:], atol=0.03)


def test_a_wheel_stops_when_nobody_talks_any_more(enabled, bench):
    """The bus watchdog: a killed process leaves a held robot."""
    (start,) = enabled.read()
    hold(enabled, bench, ServoSetpoint(np.full(4, 1.0), start.position_rad[4:]), 0.5)
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 1_500_000_000)
    (quiet,) = enabled.read()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 20_000_000)
    (later,) = enabled.read()
    np.testing.assert_allclose(later.position_rad[:4], quiet.position_rad[:4], atol=0.02)


def test_goals_beyond_the_limits_are_clipped(enabled, bench):
    (start,) = enabled.read()
    fast = ServoSetpoint(np.full(4, 50.0), start.position_rad[4:])
    sample = hold(enabled, bench, fast, 0.6)
    limit = bench.config.servos.velocity_limit_rad_s
    assert np.all(sample.velocity_rad_s[:4] <= limit + 0.2)
    assert np.all(sample.velocity_rad_s[:4] > 0.5)


def test_stop_never_raises_not_even_on_a_closed_port(servos):
    servos.close()
    servos.stop()


def test_health_comes_at_its_own_slow_rate(servos, bench):
    found = []
    for _ in range(250):
        servos.read()
        found += servos.read_health()
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
    assert 1 <= len(found) <= 4
    assert np.all((found[-1].voltage_v > 9) & (found[-1].voltage_v < 16))
    assert np.all((found[-1].temperature_c > 5) & (found[-1].temperature_c < 80))
