"""Every reader on every link: opened, 200 samples of the present, cut, back, closed."""

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest

from hil.bench.reconnect import reconnecting
from hil.config.adhesion import VescConfig
from hil.config.encoders import EncodersConfig
from hil.config.imu import Bno055Config
from hil.config.load_cells import CanCellsConfig, LineCellsConfig
from hil.config.mavlink import MavlinkTrackerConfig
from hil.config.microstrain import MicrostrainConfig
from hil.config.servos import ServosConfig
from hil.config.tracker import T265Config
from hil.core.clock import MonotonicClock
from hil.drivers.adhesion.vesc.driver import VescFan
from hil.drivers.encoders.as5045.driver import As5045Encoders
from hil.drivers.imu.bno055.driver import Bno055Imu
from hil.drivers.imu.microstrain.driver import MicrostrainImu
from hil.drivers.load_cells.hx711.can_driver import CanCells
from hil.drivers.load_cells.hx711.line_driver import LineCells
from hil.drivers.servos.dynamixel.driver import DynamixelServos
from hil.drivers.tracker.mavlink.driver import MavlinkTracker
from hil.drivers.tracker.t265.driver import T265Tracker
from hil.fan_daemon.spec import Spec
from tests.adhesion.kills import end_daemon
from tests.emulate.emulators import emulator
from tests.selected import every
from tests.wire import links_that_break as links

pytestmark = [pytest.mark.real_time, pytest.mark.timeout(600), pytest.mark.usefixtures("warm_commands")]

PATIENT = {"open_timeout_s": 10.0, "fail_after_s": 10.0}
SERVOS = {"prefetch": True, "reply_slack_s": 0.02}
DEVICES = {
    "load_cells": (LineCells, LineCellsConfig, PATIENT),
    "imu": (MicrostrainImu, MicrostrainConfig, {**PATIENT, "reply_timeout_s": 0.5}),
    "tracker": (MavlinkTracker, MavlinkTrackerConfig, PATIENT),
    "can": (As5045Encoders, EncodersConfig, {**PATIENT, "rate_hz": 50.0}),
    "servos": (
        DynamixelServos,
        ServosConfig,
        {"fail_after_s": 10.0, "prefetch": True, "reply_slack_s": 0.02},
    ),
    "bno055": (Bno055Imu, Bno055Config, {**PATIENT, "prefetch": True, "reply_timeout_s": 0.05}),
    "can_cells": (CanCells, CanCellsConfig, PATIENT),
    "adhesion": (VescFan, VescConfig, PATIENT),
    "t265": (T265Tracker, T265Config, PATIENT),
}
"""Driver, its table, and keys that allow for a busy computer, by device."""
FLOOR = """schema = 1
name = "links"
[environment]
surface = "floor"
tilt_rad = 0.0
"""
ONE = """[load_cells]
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
rate_hz = 50.0
"""
OTHER = """[servos]
backend = "emulated"
[imu]
model = "bno055"
backend = "emulated"
[load_cells]
model = "hx711_can"
backend = "emulated"
[tracker]
model = "t265"
backend = "emulated"
[adhesion]
model = "vesc"
backend = "emulated"
"""
AS_NAMED = {"imu": "bno055", "load_cells": "can_cells", "tracker": "t265"}
"""Devices of the second bench by their names in its emulator's line, where those are taken."""
PORTS = ("load_cells", "imu", "tracker", "servos", "bno055")
SERIAL = [(device, link) for device in PORTS for link in ("socket", "rfc2217", "")]
BUSES = (links.Slcan, links.Remote, links.SocketCand, links.Multicast)
CAN = [(device, link) for device in ("can", "can_cells") for link in BUSES]
FAN = [
    ("adhesion", link) for link in (links.Remote, links.Multicast)
]  # where its daemon gets the frames, too
SAMPLES = 200


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Endpoints of one device for each kind of reader, served by two other processes."""
    folder = tmp_path_factory.mktemp("links")
    with contextlib.ExitStack() as stack:
        found = {}
        for number, devices in enumerate((ONE, OTHER)):
            path = folder / f"bench_{number}.toml"
            path.write_text(FLOOR + devices.format(folder=folder), encoding="utf-8")
            running = stack.enter_context(emulator("--bench", str(path))).endpoints()
            found |= {AS_NAMED.get(name, name) if number else name: at for name, at in running.items()}
        yield found


@pytest.fixture
def state(monkeypatch, tmp_path):
    """A folder of its own for a fan's daemon."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


class Reader:
    """A driver as a bench has it, read at 100 Hz."""

    def __init__(self, name, table):
        driver, config, patient = DEVICES[name]
        self.clock, self.config = MonotonicClock(), config(**table, **patient)
        made = {name: driver(self.config, self.clock)}
        self.driver = reconnecting(made, self.clock)[name]

    def read(self, count, limit_s):
        """So many samples with values; which reads gave some; the time that each took, s."""
        samples, gave, took_s = [], [], []
        end_ns = self.clock.now_ns() + limit_s * 1e9
        while len(samples) < count and (now_ns := self.clock.now_ns()) < end_ns:
            new = [sample for sample in self.driver.read() if "ok" in said_of(sample)]
            took_s.append((self.clock.now_ns() - now_ns) * 1e-9)
            gave.append(bool(new))
            samples += new
            self.clock.sleep_until_ns(self.clock.now_ns() + 10_000_000)
        return SimpleNamespace(samples=samples, gave=gave, took_s=took_s)


def said_of(sample):
    """Every status in a sample."""
    return {one.value for one in (sample.status if isinstance(sample.status, tuple) else (sample.status,))}


def check(samples):
    """They are of the present: in order, of true age, with every value but where something was lost."""
    assert np.all(np.diff([s.stamp.seq for s in samples]) > 0)
    assert np.all(np.diff([s.stamp.t_ns for s in samples]) > 0)
    ages_ms = [1e-6 * (s.stamp.host_ns - s.stamp.t_ns) for s in samples]
    assert -1.0 < np.median(ages_ms) < 250.0
    assert np.mean([said_of(sample) == {"ok"} for sample in samples]) > 0.8


@pytest.mark.parametrize(("device", "link"), every(3, SERIAL + CAN + FAN))
def test_a_reader_on_a_link_that_is_cut_and_comes_back(served, state, tmp_path, device, link):
    endpoint = served[device]
    if isinstance(link, str):
        way = links.NetworkPort(endpoint, link) if link else links.LocalPort(endpoint)
    else:
        way = link(endpoint, tmp_path)
    with contextlib.ExitStack() as stack:
        if way.cut is not None:
            stack.callback(way.cut)
        reader = Reader(device, way.table)
        if device == "adhesion":
            stack.callback(end_daemon, Spec(**reader.config.daemon_spec()))
        reader.driver.open()
        stack.callback(reader.driver.close)
        reader.read(20, 20.0)
        first = reader.read(SAMPLES, 60.0)
        assert len(first.samples) >= SAMPLES
        check(first.samples)
        assert np.median(np.diff(np.flatnonzero(first.gave))) <= 5, "nothing waits for further reads"
        assert np.median(first.took_s) < 0.01, "no read waits"
        if way.cut is None:
            return
        way.cut()
        reader.read(10_000, 0.8)
        assert not reader.read(10, 0.4).samples
        way.mend()
        if device == "servos":  # a stopped robot's bus is opened anew, by the check whether it is held
            reader.driver.open()
        reader.read(20, 30.0)
        again = reader.read(SAMPLES // 4, 20.0)
        assert len(again.samples) >= SAMPLES // 4
        check(again.samples)
        assert again.samples[0].stamp.t_ns > first.samples[-1].stamp.t_ns
        if device != "servos":
            assert again.samples[0].stamp.seq > first.samples[-1].stamp.seq


def test_a_camera_at_its_emulator_until_it_is_closed(served):
    """The link of an emulated T265 is one of this bench's own; the real one is USB."""
    endpoint = served["t265"]
    reader = Reader("t265", {"endpoint": {key: endpoint[key] for key in ("host", "port")}})
    reader.driver.open()
    reader.read(20, 20.0)
    found = reader.read(SAMPLES, 60.0)
    reader.driver.close()
    assert len(found.samples) >= SAMPLES
    check(found.samples)
