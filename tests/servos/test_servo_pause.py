"""Nothing talks to the servos for a while: torque is off, or the whole program stands still."""

import numpy as np
import pytest

from hil.core.errors import DeviceTimeoutError
from hil.core.signals import ServoSetpoint, Status

SECOND = 1_000_000_000


def read_for(bench, cycles):
    for _ in range(cycles):
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
        bench.driver.read()


def test_a_pause_longer_than_the_persistence_is_not_a_dead_servo(servo_bench):
    """One lost answer right after the pause is one bad sample, not seconds of silence."""
    bench = servo_bench("servos:drop@5+0.05,probability=1")
    bench.clock.sleep_until_ns(5 * SECOND + 10_000_000)
    (first,) = bench.driver.read()
    assert Status.TIMEOUT in first.status
    bench.clock.sleep_until_ns(5 * SECOND + 100_000_000)
    bench.driver.read()
    bench.clock.sleep_until_ns(5 * SECOND + 200_000_000)
    (later,) = bench.driver.read()
    assert all(s in (Status.OK, Status.RESET) for s in later.status)


def test_several_pauses_are_not_a_dead_servo_and_a_dead_one_is_still_found(servo_bench):
    """Reads after long pauses are all marked RESET; only what is asked and not answered counts."""
    bench = servo_bench("servo.3:off@8", config={"fail_after_s": 2.0})
    bench.driver.enable()
    for _ in range(3):
        bench.world.advance_to(bench.clock.now_ns() + 1_500_000_000)
        (marked,) = bench.driver.read()
        assert Status.RESET in marked.status
    bench.clock.sleep_until_ns(8 * SECOND)
    with pytest.raises(DeviceTimeoutError, match=r"nothing usable .*ID 3"):
        read_for(bench, 400)


def test_a_bus_that_was_away_for_as_long_as_the_watchdog_waits_is_obeyed_again_at_once(servo_bench):
    """A tripped watchdog refuses goals in silence until the next check; health is looked at much later."""
    bench = servo_bench("servos:unplug@1.1+0.1", config={"health_period_s": 60.0})
    bench.driver.enable()
    while bench.clock.now_ns() < 1.35 * SECOND:
        bench.driver.read()
        bench.driver.command(ServoSetpoint(np.full(4, 2.0), np.zeros(4)))
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
    assert not any(s.tripped for s in bench.bus.servos)
    np.testing.assert_allclose(bench.plant.velocity[:4], 2.0, atol=0.3)


@pytest.mark.parametrize("share", [0.55, 0.95])
def test_a_pause_just_shorter_than_the_watchdog_waits_is_looked_into(servo_bench, share):
    """The servos' clocks are not the host's: they may have tripped, and would refuse goals in silence."""
    bench = servo_bench(config={"health_period_s": 60.0})
    bench.driver.enable()
    bench.driver.read()
    bench.world.advance_to(bench.clock.now_ns() + round(share * 0.08 * SECOND))
    for servo in bench.bus.servos:
        servo.trip()
    read_for(bench, 2)
    assert not any(s.tripped for s in bench.bus.servos)


def test_a_watchdog_that_trips_unnoticed_stops_a_wheel_for_less_than_makes_it_blocked(servo_bench):
    bench = servo_bench()
    bench.driver.enable()
    for k in range(120):
        bench.driver.read()
        bench.driver.command(ServoSetpoint(np.full(4, 2.0), np.zeros(4)))
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
        if k == 60:
            bench.bus.servos[1].trip()
        if k == 61:
            assert bench.bus.servos[1].tripped
        if k == 61 + 30:
            assert not bench.bus.servos[1].tripped
    np.testing.assert_allclose(bench.plant.velocity[:4], 2.0, atol=0.3)
