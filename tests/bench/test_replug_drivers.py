"""Each sensor's own driver in real time while its plug is pulled again and again.

Serial ports hang up and come back under another terminal's name behind the same link, the CAN interface is
down, the camera's and the motion capture's streams end.
"""

import contextlib
import gc
import itertools
import os
import re
import threading
import time
from collections import Counter

import numpy as np
import pytest
from pulled import Pulls, Served
from turning_plant import TurningPlant

from hil.bench.drivers import model_of
from hil.bench.replug import Replugged, replugged
from hil.devices.imu.microstrain.chip import MicrostrainChip
from hil.devices.imu.microstrain.config import MicrostrainConfig
from hil.devices.imu.microstrain.driver import MicrostrainImu
from hil.drivers import serial_url
from hil.fakes.serial_line import SerialLine
from hil.fakes.serial_pty import SerialPty
from hil.fakes.server import EmulationServer
from hil.fakes.world import World
from hil.ring.sample_watch import SampleWatch
from hil.vocabulary.clock import MonotonicClock
from hil.vocabulary.errors import DeviceError, DeviceTimeoutError
from hil.vocabulary.signals import Inputs, Status, worst

CLOCK = MonotonicClock()
PERIOD_NS = 10_000_000
BENCHES = {
    "bno055, encoders, t265, mocap": "[imu]\n[encoders]\n"
    "[tracker]\nfail_after_s = 0.3\n[mocap]\nfail_after_s = 0.3",
    "microstrain, mavlink": '[imu]\nmodel = "microstrain"\n[tracker]\nmodel = "mavlink"',
}


def left():
    """What there is of threads and open files; a thread that was told to end may take a moment."""
    time.sleep(0.2)
    gc.collect()
    found = []
    for fd in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):
            found.append(re.sub(r"\d+| \(deleted\)", "", os.readlink(f"/proc/self/fd/{fd}")))
    return threading.active_count(), Counter(found)


@pytest.fixture
def served(tmp_path, monkeypatch):
    served = []

    def build(text, pulls):
        emulated = text.replace("]\n", ']\nbackend = "emulated"\n')
        served.append(Served(emulated, tmp_path, pulls, monkeypatch))
        return served[-1]

    yield build
    for one in served:
        one.stop()


def driver_of(served, name):
    """The driver that a bench file of hardware would give, at the served port."""
    endpoint, model = served.endpoints[name], model_of(served.config, name)
    at = endpoint if "usb-" in str(endpoint.get("port")) else model.connection(endpoint)
    return model.make_driver(served.config.devices()[name].model_copy(update=dict(at)), CLOCK)


class Log:
    """What comes of sensors that are read at 100 Hz as the ring reads them.

    Attributes:
        good_ns: by sensor, times of cycles with a good sample.
        said: by sensor, what the ring's watch has said.
        terminals: by sensor, names of its port on this host.
    """

    def __init__(self, sensors):
        self.sensors, self.watch = sensors, SampleWatch(dict.fromkeys(sensors, 0.2))
        self.good_ns, self.said = ({name: [] for name in sensors} for _ in range(2))
        self.terminals = {name: set() for name in sensors}

    def read_until(self, end_s):
        cycle, next_ns = 0, CLOCK.now_ns()
        while next_ns < end_s * 1e9:
            self.cycle(cycle)
            cycle, next_ns = cycle + 1, next_ns + PERIOD_NS
            CLOCK.sleep_until_ns(next_ns)

    def cycle(self, number):
        t_ns, events = CLOCK.now_ns(), []
        read = {name: sensor.read() for name, sensor in self.sensors.items()}
        self.watch.judge(Inputs(number, t_ns, **read), events)
        for name, samples in read.items():
            if any(worst(s) is Status.OK for s in samples):
                self.good_ns[name].append(t_ns)
                port = (
                    self.sensors[name].identity().get("port")
                )  # none where these were the last before a pull
                self.terminals[name].update([os.path.realpath(port)] if port else [])
        for event in events:
            self.said[event.source].append(event.message)

    def gaps_s(self, name, least_s):
        """Silences of at least so long: as they were, and as the watch has named them."""
        steps = [(b - a) * 1e-9 for a, b in itertools.pairwise(self.good_ns[name])]
        named = [float(word.split()[-2]) for word in self.said[name] if word.startswith("answers again")]
        return ([gap_s for gap_s in gaps_s if gap_s > least_s] for gaps_s in (steps, named))


def pull_and_look(bench):
    """Every sensor of a bench is pulled as planned; nothing may end, nothing may be left."""
    before = left()
    sensors = replugged({name: driver_of(bench, name) for name in bench.endpoints}, CLOCK)
    assert all(isinstance(sensor, Replugged) for sensor in sensors.values())
    for sensor in sensors.values():
        sensor.open()
    opened, log = left(), Log(sensors)
    log.read_until(bench.began_s + bench.pulls.end_s)
    assert left() == opened
    for sensor in sensors.values():
        sensor.close()
    assert left() == before
    for name in sensors:
        were_s, named_s = log.gaps_s(name, bench.pulls.away_s - 0.1)
        assert len(were_s) == bench.pulls.times, (name, np.round(were_s, 2).tolist(), log.said[name])
        assert named_s == pytest.approx(were_s, abs=0.02), name
    return log


def test_an_imu_whose_port_hangs_up_comes_back_under_another_name(served):
    log = pull_and_look(served('[imu]\nmodel = "microstrain"', Pulls(2, 1.2, 0.4, first_s=3.0)))
    assert len(log.terminals["imu"]) > 1


@pytest.fixture
def adapters(tmp_path, monkeypatch):
    """A folder like `/dev/serial/by-id` with one adapter, which has become `ttyUSB1`."""
    folder = tmp_path / "by-id"
    folder.mkdir()
    (tmp_path / "ttyUSB1").touch()
    link = folder / "usb-FTDI_FT232R_A50285BI-if00-port0"
    link.symlink_to("../ttyUSB1")
    monkeypatch.setattr(serial_url, "BY_ID", folder)
    return folder


def test_an_adapter_that_has_got_another_name_is_named_by_the_one_that_stays(adapters, tmp_path):
    gone = MicrostrainImu(MicrostrainConfig(port=str(tmp_path / "ttyUSB0")), CLOCK)
    with pytest.raises(DeviceError, match="No such file") as told:
        gone.open()
    (link,) = adapters.iterdir()
    assert f"plugged in now: {link} (ttyUSB1): name the port by its link" in told.value.remedy
    other = MicrostrainImu(MicrostrainConfig(port=str(adapters / "usb-FTDI_FT232R_OTHER-if00")), CLOCK)
    with pytest.raises(DeviceError, match="No such file") as told:
        other.open()
    assert told.value.remedy.startswith("plug in the adapter with this serial number, or name another one")
    assert str(link) in told.value.remedy
    link.unlink()
    with pytest.raises(DeviceError, match="No such file") as told:
        gone.open()
    assert "`hil discover` lists ports" in told.value.remedy


def test_a_port_that_is_gone_for_good_ends_the_run_with_what_is_plugged_in(adapters, tmp_path):
    world = World(TurningPlant(), seed=1)
    face = SerialPty(SerialLine(world, MicrostrainChip(world)))
    server = EmulationServer(world, CLOCK, {"imu": face})
    thread = threading.Thread(target=server.run)
    thread.start()
    port = tmp_path / "ttyUSB0"
    port.symlink_to(face.endpoint()["port"])
    sensor = Replugged(MicrostrainImu(MicrostrainConfig(port=str(port)), CLOCK), CLOCK, patience_s=0.1)
    sensor.open()
    server.stop()
    thread.join(10)
    port.unlink()
    with pytest.raises(DeviceTimeoutError, match=r"its port has gone; it did not come back") as told:
        read_on(sensor)
    assert "plugged in now: " in told.value.remedy
    sensor.close()


def read_on(sensor):
    while True:
        sensor.read()
        CLOCK.sleep_until_ns(CLOCK.now_ns() + PERIOD_NS)


@pytest.mark.long
@pytest.mark.parametrize("name", BENCHES)
def test_every_sensor_is_pulled_a_hundred_times(served, name):
    pull_and_look(served(BENCHES[name], Pulls(100, 2.4, 0.8, first_s=8.0)))
