"""Nobody talks to the servos for a while, as while other devices open or a trajectory is computed."""

import logging

from hil.signals import Status

SECOND = 1_000_000_000


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


def test_a_watchdog_that_trips_in_a_pause_is_armed_again_without_a_warning(servo_bench, caplog):
    bench = servo_bench()
    bench.driver.enable()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + SECOND)
    with caplog.at_level(logging.DEBUG, "hil.drivers.servos"):
        (marked,) = bench.driver.read()
    assert marked.status == (Status.RESET,) * 8
    found = [r for r in caplog.records if "tripped" in r.message]
    assert len(found) == 8
    assert all(r.levelno == logging.DEBUG for r in found)
