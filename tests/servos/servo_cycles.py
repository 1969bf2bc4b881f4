"""Cycles of a servo driver at 100 Hz, and what was seen in them."""

import numpy as np

from hil.core.signals import ServoSetpoint

SECOND = 1_000_000_000
CYCLE_NS = 10_000_000
ROLLING = ServoSetpoint(np.array([1.0, -1.0, 2.0, 0.5]), np.array([0.2, -0.2, 0.1, 0.0]))
STILL = ServoSetpoint(np.zeros(4), np.zeros(4))


def cycles(bench, until_s, setpoint=None):
    """Read (and command) at 100 Hz until a bench time; all samples."""
    samples, t_ns = [], bench.clock.now_ns()
    while t_ns < until_s * SECOND:
        (sample,) = bench.driver.read()
        samples.append(sample)
        bench.driver.read_health()
        if setpoint is not None:
            bench.driver.command(setpoint)
        t_ns = max(t_ns + CYCLE_NS, bench.clock.now_ns())
        bench.clock.sleep_until_ns(t_ns)
    return samples


def statuses(samples, joint):
    return {s.status[joint] for s in samples}


def between(samples, start_s, end_s):
    return [s for s in samples if start_s * SECOND <= s.stamp.t_ns < end_s * SECOND]
