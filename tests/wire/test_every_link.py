"""Every reader on every link: opened, 200 samples of the present, cut, back, closed."""

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest

from hil.bench.reconnect import Reconnecting
from hil.config.encoders import EncodersConfig
from hil.config.load_cells import LineCellsConfig
from hil.core.clock import MonotonicClock
from hil.devices.imu.microstrain.config import MicrostrainConfig
from hil.devices.imu.microstrain.driver import MicrostrainImu
from hil.devices.tracker.mavlink.config import MavlinkTrackerConfig
from hil.devices.tracker.mavlink.driver import MavlinkTracker
from hil.drivers.encoders import As5045Encoders
from hil.drivers.load_cells import LineCells
from tests.emulate.emulators import emulator
from tests.selected import every
from tests.wire import links_that_break as links

pytestmark = [pytest.mark.real_time, pytest.mark.timeout(600)]

PATIENT = {"open_timeout_s": 10.0, "fail_after_s": 10.0}
DEVICES = {
    "load_cells": (LineCells, LineCellsConfig, PATIENT),
    "imu": (MicrostrainImu, MicrostrainConfig, {**PATIENT, "reply_timeout_s": 0.5}),
    "tracker": (MavlinkTracker, MavlinkTrackerConfig, PATIENT),
    "can": (As5045Encoders, EncodersConfig, PATIENT),
}
"""By name in the emulator's line: driver, its table, and keys that allow for a busy computer."""
BENCH = """schema = 1
name = "links"
[environment]
surface = "floor"
tilt_rad = 0.0
[load_cells]
model = "hx711_line"
backend = "emulated"
[imu]
model = "microstrain"
backend = "emulated"
[tracker]
model = "mavlink"
backend = "emulated"
port = "{folder}/tracker"
baud = 921600
[encoders]
backend = "emulated"
"""
SERIAL = [(device, link) for device in ("load_cells", "imu", "tracker") for link in ("socket", "rfc2217", "")]
CAN = [("can", link) for link in (links.Slcan, links.Remote, links.SocketCand, links.Multicast)]
SAMPLES = 200


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Endpoints of one device for each kind of reader, served by another process."""
    folder = tmp_path_factory.mktemp("links")
    path = folder / "bench.toml"
    path.write_text(BENCH.format(folder=folder), encoding="utf-8")
    with emulator("--bench", str(path)) as running:
        yield running.endpoints()


class Reader:
    """A driver as a bench has it, read at 100 Hz."""

    def __init__(self, name, table):
        driver, config, patient = DEVICES[name]
        self.clock = MonotonicClock()
        self.driver = Reconnecting(driver(config(**table, **patient), self.clock), self.clock, 30.0)

    def read(self, count, limit_s):
        """So many samples; the time that they took, s."""
        samples, began_ns = [], self.clock.now_ns()
        while len(samples) < count and self.clock.now_ns() - began_ns < limit_s * 1e9:
            samples += self.driver.read()
            self.clock.sleep_until_ns(self.clock.now_ns() + 10_000_000)
        return SimpleNamespace(samples=samples, took_s=(self.clock.now_ns() - began_ns) * 1e-9)


def check(samples):
    """They are of the present: in order, of true age, without values only where something was lost."""
    assert np.all(np.diff([s.stamp.seq for s in samples]) > 0)
    assert np.all(np.diff([s.stamp.t_ns for s in samples]) > 0)
    ages_ms = [1e-6 * (s.stamp.host_ns - s.stamp.t_ns) for s in samples]
    assert -1.0 < np.median(ages_ms) < 250.0
    statuses = [s.status if isinstance(s.status, tuple) else (s.status,) for s in samples]
    assert np.mean([{one.value for one in status} == {"ok"} for status in statuses]) > 0.8


@pytest.mark.parametrize(("device", "link"), every(3, SERIAL + CAN))
def test_a_reader_on_a_link_that_is_cut_and_comes_back(served, tmp_path, device, link):
    endpoint = served[device]
    if isinstance(link, str):
        way = links.NetworkPort(endpoint, link) if link else links.LocalPort(endpoint)
    else:
        way = link(endpoint, tmp_path)
    with contextlib.ExitStack() as stack:
        if way.cut is not None:
            stack.callback(way.cut)
        reader = Reader(device, way.table)
        reader.driver.open()
        stack.callback(reader.driver.close)
        reader.read(20, 20.0)
        first = reader.read(SAMPLES, 60.0)
        assert len(first.samples) >= SAMPLES
        check(first.samples)
        assert first.took_s < SAMPLES / 50.0, "none waits for the next read"
        if way.cut is None:
            return
        way.cut()
        reader.read(10_000, 0.8)
        assert not reader.read(10, 0.4).samples
        way.mend()
        reader.read(20, 30.0)
        again = reader.read(SAMPLES // 4, 20.0)
        assert len(again.samples) >= SAMPLES // 4
        check(again.samples)
        assert again.samples[0].stamp.seq > first.samples[-1].stamp.seq
