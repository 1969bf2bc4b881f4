"""A CAN adapter whose bus fails for good, with any exception: it is opened anew, and its sensor goes on."""

import threading

import can
import pytest

from hil.config.load_cells import CanCellsConfig
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.drivers.load_cells.hx711.can_driver import CanCells
from hil.links import can_bus

PATIENT = CanCellsConfig(
    interface="usb", channel="usb0", rate_hz=80.0, open_timeout_s=10.0, fail_after_s=10.0
)
FRAME_ID, COUNTS = 0x1B0, bytes((0, 1, 0, 0, 2, 0, 0, 3))


class Adapter(can.BusABC):
    """Sends a frame at every second question; once it has a `failure` it fails for good."""

    def __init__(self):
        super().__init__(channel="usb0")
        self.failure, self.asked, self.frame_due = None, 0, threading.Event()

    def send(self, msg, timeout=None):
        raise can.CanOperationError("it only listens")

    def _recv_internal(self, timeout):
        if self.failure is not None:
            raise self.failure
        if timeout:
            self.frame_due.wait(min(timeout, 0.01))
        self.asked += 1
        data = COUNTS[:-1] + bytes([self.asked % 256])
        frame = can.Message(arbitration_id=FRAME_ID, data=data, is_extended_id=False)
        return (frame if self.asked % 2 else None), True


class Adapters(list):
    """Those that were opened, in order."""

    refused = False

    def fails_from_now_on(self):
        self.refused = True


@pytest.fixture
def adapters(monkeypatch):
    opened = Adapters()

    def open_bus(device, config, expected=""):
        if opened.refused:
            raise DeviceError(device, "no more adapters")
        opened.append(Adapter())
        return opened[-1]

    monkeypatch.setattr(can_bus, "open_bus", open_bus)
    yield opened
    for adapter in opened:
        adapter.shutdown()


class ClosedError(Exception):
    """As python-can-remote raises: of no class that python-can knows."""


@pytest.mark.real_time
@pytest.mark.parametrize(
    "failure",
    [
        can.CanOperationError("device not configured"),
        ClosedError("Status: 1006"),
        IndexError("string index out of range"),
    ],
)
def test_the_bus_is_opened_again_and_samples_count_on(adapters, failure):
    clock = MonotonicClock()
    cells = CanCells(PATIENT, clock)
    cells.open()
    try:
        before = read_until(cells, clock, lambda samples: samples)
        adapters[0].failure = failure
        assert read_until(cells, clock, lambda _: len(adapters) == 2) is not None
        after = read_until(cells, clock, lambda samples: samples)
        assert after[0].stamp.seq > before[-1].stamp.seq
        assert clock.now_ns() - after[-1].stamp.t_ns < 1_000_000_000
    finally:
        cells.close()


@pytest.mark.real_time
def test_silence_of_a_failed_bus_bears_its_error(adapters):
    clock = MonotonicClock()
    cells = CanCells(PATIENT.model_copy(update={"fail_after_s": 0.3}), clock)
    cells.open()
    adapters.fails_from_now_on()
    adapters[0].failure = ClosedError("Status: 1006")
    with pytest.raises(DeviceTimeoutError, match="no more adapters"):
        read_until(cells, clock, lambda _: False)
    cells.close()


def read_until(sensor, clock, done):
    """Read at 100 Hz until that is so, for 10 s at the most; the samples of that read, None for too late."""
    end_ns = clock.now_ns() + 10_000_000_000
    while clock.now_ns() < end_ns:
        samples = sensor.read()
        if done(samples):
            return samples
        clock.sleep_until_ns(clock.now_ns() + 10_000_000)
    return None
