"""A burst that takes longer than a cycle: the loop does not wait for it, and none is lost."""

import numpy as np
import pytest

from hil.config.imu import Bno055Config
from hil.core.signals import Status
from hil.drivers.imu.bno055.driver import Bno055Imu
from hil.fakes.imu.bno055.chip import Bno055Chip
from hil.fakes.serial_line import SerialLine
from hil.fakes.world import VirtualClock, World

PERIOD_NS = 4_000_000


@pytest.fixture
def fast_cycles(turning_plant):
    """A driver that asks ahead behind an adapter with a latency timer; 400 reads at 250 Hz."""
    world = World(turning_plant(rate_rad_s=0.5))
    line = SerialLine(world, Bno055Chip(world, overrun_probability=0.0), name="slow", latency_s=0.001).open()
    clock = VirtualClock(world)
    driver = Bno055Imu(Bno055Config(port="hil://slow", backend="emulated", prefetch=True), clock)
    driver.open()
    found, took_ns = [], []
    for _ in range(400):
        clock.sleep_until_ns(clock.now_ns() + PERIOD_NS)
        before_ns = clock.now_ns()
        found.append(driver.read())
        took_ns.append(clock.now_ns() - before_ns)
    line.close()
    return found, took_ns


def test_no_read_waits_longer_than_a_look(fast_cycles):
    found, took_ns = fast_cycles
    assert max(took_ns[5:]) <= 100_000
    assert [len(f) for f in found[10:]].count(1) == pytest.approx(195, abs=5)


def test_every_burst_arrives_once_and_is_good(fast_cycles):
    samples = [s for f in fast_cycles[0][5:] for s in f]
    assert {s.status for s in samples} == {Status.OK}
    assert set(np.diff([s.stamp.seq for s in samples])) == {1}
    assert np.all(np.diff([s.stamp.t_ns for s in samples]) == pytest.approx(2 * PERIOD_NS, abs=PERIOD_NS))
