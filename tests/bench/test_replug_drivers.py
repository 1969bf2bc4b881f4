"""An inertial unit's own driver in real time when its serial port hangs up, comes back or is gone."""

import contextlib
import os
import threading

import pytest
from turning_plant import TurningPlant

from hil.bench.reconnect import Reconnecting
from hil.config.microstrain import MicrostrainConfig
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import Status, worst
from hil.drivers.imu.microstrain.driver import MicrostrainImu
from hil.fakes.imu.microstrain.chip import MicrostrainChip
from hil.fakes.serial_line import SerialLine
from hil.fakes.serial_pty import SerialPty
from hil.fakes.server import EmulationServer
from hil.fakes.world import World
from hil.links import serial_url

CLOCK = MonotonicClock()
PERIOD_NS = 10_000_000


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
    with pytest.raises(DeviceError, match="No such file") as reported:
        gone.open()
    (link,) = adapters.iterdir()
    assert f"plugged in now: {link} (ttyUSB1)" in reported.value.remedy


@contextlib.contextmanager
def served(link):
    """An inertial unit at a terminal of its own, which `link` leads to until it hangs up."""
    world = World(TurningPlant(), seed=1)
    transport = SerialPty(SerialLine(world, MicrostrainChip(world)))
    server = EmulationServer(world, CLOCK, {"imu": transport})
    thread = threading.Thread(target=server.run)
    thread.start()
    link.symlink_to(transport.endpoint()["port"])
    try:
        yield os.path.realpath(link)
    finally:
        server.stop()
        thread.join(10)
        link.unlink()


def good_from(sensor):
    """Read until a good sample comes; the driver's own limit ends it otherwise."""
    while not any(worst(sample) is Status.OK for sample in sensor.read()):
        CLOCK.sleep_until_ns(CLOCK.now_ns() + PERIOD_NS)


def test_an_imu_whose_port_hangs_up_comes_back_at_another_terminal(tmp_path):
    port, threads = tmp_path / "ttyUSB0", threading.active_count()
    sensor = Reconnecting(MicrostrainImu(MicrostrainConfig(port=str(port)), CLOCK), CLOCK)
    with served(port) as first:
        sensor.open()
        good_from(sensor)
    assert sensor.read() == ()
    taken = os.openpty()  # so that the next terminal has another number
    with served(port) as second:
        good_from(sensor)
        sensor.close()
    for fd in taken:
        os.close(fd)
    assert first != second
    assert threading.active_count() == threads


def test_a_port_that_is_gone_for_good_ends_the_run_with_what_is_plugged_in(adapters, tmp_path):
    port = tmp_path / "ttyUSB0"
    sensor = Reconnecting(MicrostrainImu(MicrostrainConfig(port=str(port)), CLOCK), CLOCK, patience_s=0.1)
    with served(port):
        sensor.open()
    with pytest.raises(DeviceTimeoutError, match=r"its port has gone; it did not come back") as reported:
        read_on(sensor)
    assert "plugged in now: " in reported.value.remedy
    sensor.close()


def read_on(sensor):
    while True:
        sensor.read()
        CLOCK.sleep_until_ns(CLOCK.now_ns() + PERIOD_NS)
