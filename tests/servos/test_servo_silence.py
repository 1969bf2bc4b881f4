"""What a program finds that has stood still for longer than the bus watchdog allows."""

import numpy as np

from hil.core.signals import ServoSetpoint, Status


def test_repairing_eight_tripped_watchdogs_does_not_cost_the_read_behind_it(servo_bench):
    """The repair's packets are still leaving when the read is asked: its timeout starts behind them."""
    bench = servo_bench()
    bench.driver.enable()
    for _ in range(3):
        bench.driver.command(ServoSetpoint(np.full(4, 1.0), np.zeros(4)))
        bench.world.advance_to(bench.clock.now_ns() + 1_000_000_000)
        (marked,) = bench.driver.read()
        assert marked.status == (Status.RESET,) * 8
        (sample,) = bench.driver.read()
        assert sample.ok


def test_a_read_is_stamped_behind_the_packets_that_leave_before_it(servo_bench):
    bench = servo_bench()
    bench.driver.enable()
    began_ns = bench.clock.now_ns()
    (quick,) = bench.driver.read()
    alone_ns = quick.stamp.t_ns - began_ns
    began_ns = bench.clock.now_ns()
    for _ in range(4):
        bench.driver.command(ServoSetpoint(np.zeros(4), np.zeros(4)))
    (queued,) = bench.driver.read()
    assert queued.ok
    bits_of_a_write = 10 * (14 + 8 * 5)
    written_ns = 4 * bits_of_a_write * 1_000_000_000 // int(bench.driver.identity()["baud"])
    assert queued.stamp.t_ns - began_ns - alone_ns >= 0.8 * written_ns
