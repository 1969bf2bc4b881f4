"""What the servos promise, whoever answers on the wire."""

import numpy as np
import pytest

from hil.pytest_plugin.contract import closed_bench, pytest_generate_tests  # noqa: F401
from hil.vocabulary.signals import ServoSetpoint

pytestmark = pytest.mark.moves
OVERRIDES = {"servos.reply_slack_s": 0.02, "servos.retry_budget_s": 0.02}
"""At the wire this computer's load must not count as a servo's silence: the contract is about behaviour."""

PATIENCE_S = 1.0


@pytest.fixture
def bench(closed_bench):
    """The suite's, whose devices the tests open."""
    return closed_bench


def pause(bench, duration_s):
    bench.clock.sleep_until_ns(bench.clock.now_ns() + round(duration_s * 1e9))


def fresh(servos, bench):
    """The next sample in which all eight are good: a reading lost or marked is data, not a failure."""
    for _ in range(round(PATIENCE_S * bench.config.loop.rate_hz)):
        (sample,) = servos.read()
        if sample.ok:
            return sample
        pause(bench, 1.0 / bench.config.loop.rate_hz)
    raise AssertionError(f"no good sample in {PATIENCE_S} s: {sample.status}")


def at_loop_rate(servos, bench, duration_s, setpoint=None):
    """Read (and command) at the loop rate; the last good sample."""
    period_ns = round(1e9 / bench.config.loop.rate_hz)
    next_ns = bench.clock.now_ns()
    for _ in range(round(duration_s * bench.config.loop.rate_hz)):
        if setpoint is not None:
            servos.command(setpoint)
        servos.read()
        next_ns += period_ns
        bench.clock.sleep_until_ns(next_ns)
    return fresh(servos, bench)


@pytest.fixture
def enabled(servos, bench):
    servos.enable()
    yield servos
    servos.stop()


def still(sample):
    return ServoSetpoint(np.zeros(4), sample.position_rad[4:].copy())


def rolling(sample, rate_rad_s=1.0):
    return ServoSetpoint(np.full(4, rate_rad_s), sample.position_rad[4:].copy())


def test_enabling_moves_nothing(servos, bench):
    """A robot without torque may creep down its wall until the moment at which it is held."""
    before = fresh(servos, bench)
    servos.enable()
    held = fresh(servos, bench)
    after = at_loop_rate(servos, bench, 0.5, still(held))
    np.testing.assert_allclose(held.position_rad, before.position_rad, atol=0.1)
    np.testing.assert_allclose(after.position_rad, held.position_rad, atol=0.02)


def test_goals_are_reached_with_their_sign(enabled, bench):
    start = fresh(enabled, bench)
    steps = np.array([0.1, -0.1, 0.1, -0.1])
    turned = ServoSetpoint(5.0 * steps, start.position_rad[4:] + steps)
    sample = at_loop_rate(enabled, bench, 1.5, turned)
    np.testing.assert_allclose(sample.velocity_rad_s[:4], turned.drive_velocity_rad_s, atol=0.1)
    np.testing.assert_allclose(sample.position_rad[4:], turned.steer_position_rad, atol=0.03)
    moved = sample.position_rad[:4] - start.position_rad[:4]
    assert np.all(np.sign(moved) == np.sign(turned.drive_velocity_rad_s))
    back = at_loop_rate(enabled, bench, 1.0, still(start))
    np.testing.assert_allclose(back.position_rad[4:], start.position_rad[4:], atol=0.03)


def test_stop_holds_the_steering_and_rests_the_wheels(enabled, bench):
    start = fresh(enabled, bench)
    at_loop_rate(enabled, bench, 0.5, rolling(start))
    enabled.stop()
    resting = at_loop_rate(enabled, bench, 0.4)
    later = at_loop_rate(enabled, bench, 0.4)
    np.testing.assert_allclose(later.position_rad, resting.position_rad, atol=0.01)
    np.testing.assert_allclose(later.position_rad[4:], start.position_rad[4:], atol=0.03)


def test_a_wheel_stops_when_nobody_talks_any_more(enabled, bench):
    """A program that forgets its wheels leaves a held robot."""
    start = fresh(enabled, bench)
    moving = at_loop_rate(enabled, bench, 0.5, rolling(start))
    pause(bench, 1.5)
    quiet = fresh(enabled, bench)
    later = at_loop_rate(enabled, bench, 0.2)
    assert np.all(quiet.position_rad[:4] - moving.position_rad[:4] < 0.8)
    np.testing.assert_allclose(later.position_rad, quiet.position_rad, atol=0.02)
    np.testing.assert_allclose(later.position_rad[4:], start.position_rad[4:], atol=0.03)


def test_servos_that_nobody_talks_to_are_looked_after_and_obey_the_next_goals(enabled, bench):
    start = fresh(enabled, bench)
    pause(bench, 5.0 * bench.config.servos.watchdog_s)
    assert not enabled.look_after().trouble
    fresh(enabled, bench)
    moving = at_loop_rate(enabled, bench, 0.5, rolling(start))
    np.testing.assert_allclose(moving.velocity_rad_s[:4], 1.0, atol=0.1)


def test_goals_beyond_the_limits_are_clipped(enabled, bench):
    fast = rolling(fresh(enabled, bench), 50.0)
    sample = at_loop_rate(enabled, bench, 0.6, fast)
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
