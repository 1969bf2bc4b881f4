"""A camera that is not there yet, and a library that fails, through a stand-in for pyrealsense2."""

import sys
from importlib import metadata
from types import SimpleNamespace

import pytest

from hil.bench.doctor.discovery import discover
from hil.config.tracker import T265Config
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError
from hil.drivers.tracker.t265.driver import T265Tracker
from hil.drivers.tracker.t265.librealsense_interface import PlainLibrary, StreamRequest, find_camera

OTHER = ("Intel RealSense D435", "1234")


class Plugged:
    """One device as the library lists it."""

    def __init__(self, name, serial):
        self._info = {"name": name, "serial_number": serial}

    def supports(self, key):
        return key in self._info

    def get_info(self, key):
        return self._info[key]


class StandIn(PlainLibrary):
    """What is used of pyrealsense2: the camera has its firmware at `there_s` of bench time.

    Args:
        bench: world, clock and emulated camera.
        fails: name of the library's call that raises.
        fails_until_s: bench time at which it stops failing.
        others: further devices, there from the beginning.
    """

    def __init__(self, bench, *, there_s=0.0, fails="", fails_until_s=1e9, others=()):
        self._bench, self._there_s, self._others = bench, there_s, others
        self._fails, self._until_s = fails, fails_until_s
        self.looks = 0

    def _may_fail(self, call):
        if call == self._fails and self._now_s() < self._until_s:
            raise RuntimeError(f"failed to {call}: no device claimed")

    def _now_s(self):
        return self._bench.clock.now_ns() * 1e-9

    def context(self):
        self._may_fail("context")
        return SimpleNamespace(query_devices=self._devices)

    def _devices(self):
        self.looks += 1
        self._may_fail("query_devices")
        camera = self._bench.camera
        own = [(camera.model, camera.serial)] if self._now_s() >= self._there_s else []
        return [Plugged(*one) for one in (*self._others, *own)]

    def pipeline(self, context):
        self._may_fail("pipeline")
        return self._bench.camera.pipeline()

    def config(self):
        self._may_fail("config")
        return StreamRequest()


@pytest.fixture
def with_library(tracker_bench, monkeypatch):
    def build(config=None, **options):
        bench = tracker_bench()
        library = StandIn(bench, **options)
        monkeypatch.setitem(sys.modules, "pyrealsense2", library)
        bench.clock.sleep_until_ns(1_000_000)
        return bench, library, T265Tracker(T265Config(**(config or {})), bench.clock)

    return build


def test_a_camera_that_loads_its_firmware_is_waited_for(with_library):
    bench, library, driver = with_library(there_s=7.0)
    driver.open()
    assert driver.identity()["serial"] == bench.camera.serial
    assert 7.0 <= bench.clock.now_ns() * 1e-9 < 8.0
    assert library.looks > 10
    driver.close()


@pytest.mark.parametrize("call", ["query_devices", "pipeline"])
def test_a_library_that_fails_at_first_is_asked_again(with_library, call):
    bench, _, driver = with_library(fails=call, fails_until_s=3.0)
    driver.open()
    assert bench.clock.now_ns() * 1e-9 < 4.0
    driver.close()


@pytest.mark.parametrize("call", ["context", "config"])
def test_every_error_of_the_library_is_a_device_error(with_library, call):
    bench, _, driver = with_library(fails=call)
    with pytest.raises(DeviceError, match=f"failed to {call}") as caught:
        driver.open()
    assert caught.value.remedy
    assert bench.clock.now_ns() * 1e-9 < 11.0
    assert driver.identity() == {}


def test_another_camera_is_not_taken_for_the_one_that_is_still_loading(with_library):
    bench, _, driver = with_library(there_s=4.0, others=[OTHER])
    driver.open()
    assert driver.identity()["serial"] == bench.camera.serial
    driver.close()


def test_what_is_connected_instead_is_named(with_library):
    _, _, driver = with_library({"connect_timeout_s": 2.0}, there_s=100.0, others=[OTHER])
    with pytest.raises(DeviceError, match=r"no T265 is connected, but Intel RealSense D435 \(1234\)"):
        driver.open()
    _, _, driver = with_library({"connect_timeout_s": 2.0, "serial": "77"})
    with pytest.raises(DeviceError, match=r"no T265 with serial number 77 is connected, but .*T265"):
        driver.open()


def usb(folder, *devices):
    """A sysfs that shows these (vendor, product)."""
    for number, (vendor, product) in enumerate(devices):
        device = folder / "bus/usb/devices" / f"1-{number}"
        device.mkdir(parents=True)
        (device / "idVendor").write_text(vendor + "\n")
        (device / "idProduct").write_text(product + "\n")
    (folder / "bus").mkdir(exist_ok=True)
    return folder


def asked(bench, sysfs):
    said = []
    nowhere = ["hil://nowhere"]
    return discover(bench.clock, ports=nowhere, sysfs=sysfs, say=said.append), said


@pytest.mark.parametrize("ids", [("03e7", "2150"), ("8087", "0b37")])
def test_discover_waits_for_a_camera_that_usb_shows(with_library, tmp_path, ids):
    bench, _, _ = with_library(there_s=6.0)
    found, _ = asked(bench, usb(tmp_path, ("1d6b", "0002"), ids))
    assert found.sections == {"tracker": {"serial": bench.camera.serial}}


def test_discover_looks_once_where_no_camera_is_plugged_in(with_library, tmp_path):
    bench, library, _ = with_library(there_s=6.0)
    found, said = asked(bench, usb(tmp_path, ("1d6b", "0002")))
    assert found.sections == {}
    assert library.looks == 1
    assert any("no T265 is connected" in text for text in said)


def test_the_librarys_version_is_that_of_its_package():
    """pyrealsense2 2.53.1 has no `__version__`."""
    pytest.importorskip(
        "pyrealsense2", reason="no wheel for this computer, or no libusb", exc_type=ImportError
    )
    with pytest.raises(DeviceError) as caught:
        find_camera(SimpleNamespace(context=dict), "tracker", MonotonicClock(), 0.0)
    assert caught.value.expected.endswith(f"this is {metadata.version('pyrealsense2')}")
