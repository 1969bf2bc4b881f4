"""A CAN adapter that was unplugged: its bus fails for good, and the sensor on it is opened anew."""

import threading

import can
import numpy as np
import pytest

from hil.bench.reconnect import Reconnecting
from hil.config.load_cells import CanCellsConfig
from hil.config.robot import RobotConfig
from hil.core.clock import MonotonicClock
from hil.drivers.load_cells.can_cells import CanCells
from hil.fakes.plant import make_plant
from hil.fakes.world import VirtualClock, World
from hil.links import can_bus

PATIENT = CanCellsConfig(
    interface="usb", channel="usb0", rate_hz=80.0, open_timeout_s=10.0, fail_after_s=10.0
)
FRAME_ID, COUNTS = 0x1B0, bytes((0, 1, 0, 0, 2, 0, 0, 3))


class Adapter(can.BusABC):
    """Sends a frame at every second question; once it was unplugged it fails until it is opened anew."""

    def __init__(self):
        super().__init__(channel="usb0")
        self.unplugged, self.asked, self.frame_due = False, 0, threading.Event()

    def send(self, msg, timeout=None):
        raise can.CanOperationError("it only listens")

    def _recv_internal(self, timeout):
        if self.unplugged:
            raise can.CanOperationError("device not configured")
        if timeout:
            self.frame_due.wait(min(timeout, 0.01))
        self.asked += 1
        data = COUNTS[:-1] + bytes([self.asked % 256])
        frame = can.Message(arbitration_id=FRAME_ID, data=data, is_extended_id=False)
        return (frame if self.asked % 2 else None), True


@pytest.fixture
def adapters(monkeypatch):
    opened = []

    def open_bus(device, config, expected=""):
        opened.append(Adapter())
        return opened[-1]

    monkeypatch.setattr(can_bus, "open_bus", open_bus)
    yield opened
    for adapter in opened:
        adapter.shutdown()


def test_it_says_that_its_interface_has_gone_and_goes_on_counting_when_opened_again(adapters):
    clock = VirtualClock(World(make_plant(RobotConfig(), rng=np.random.default_rng(0))))
    cells = CanCells(CanCellsConfig(interface="usb", channel="usb0", rate_hz=80.0), clock)
    cells.open()
    (before,) = cells.read()
    adapters[0].unplugged = True
    assert cells.read() == ()
    assert not cells.port_gone
    clock.sleep_until_ns(clock.now_ns() + 200_000_000)
    assert cells.read() == ()
    assert cells.port_gone
    cells.reopen()
    assert not cells.port_gone
    (after,) = cells.read()
    assert after.stamp.seq == before.stamp.seq + 1
    cells.close()


def test_the_bench_opens_it_again(adapters):
    clock = MonotonicClock()
    sensor = Reconnecting(CanCells(PATIENT, clock), clock)
    sensor.open()
    try:
        assert read_until(sensor, clock, lambda samples: samples)
        adapters[0].unplugged = True
        assert read_until(sensor, clock, lambda _: len(adapters) == 2)
        assert read_until(sensor, clock, lambda samples: samples)
    finally:
        sensor.close()


def read_until(sensor, clock, done):
    """Read at 100 Hz until that is so, for 10 s at the most; whether it is."""
    end_ns = clock.now_ns() + 10_000_000_000
    while clock.now_ns() < end_ns:
        if done(sensor.read()):
            return True
        clock.sleep_until_ns(clock.now_ns() + 10_000_000)
    return False
