"""The public contract suite finds a device that does not keep its promises, and passes one that does."""

import os

import pytest
from installing import ROOT

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.usefixtures("warm_commands")

SLOPPY = """
from dataclasses import replace
from typing import Literal

import numpy as np

from hil.config.imu import Bno055Config
from hil.drivers.imu.bno055.model import Bno055
from hil.drivers.imu.bno055.driver import Bno055Imu


class Config(Bno055Config):
    model: Literal["sloppy"] = "sloppy"


class Sloppy(Bno055Imu):
    def read(self):
        if self._link is None:
            return ()
        self._clock.sleep_until_ns(self._clock.now_ns() + 100_000_000)
        noise = np.random.default_rng().normal(size=3)
        return tuple(replace(s, gyro_rad_s=s.gyro_rad_s + noise) for s in super().read()) * 2


class SloppyModel(Bno055):
    name, title, config, probe_bauds = "sloppy", "sloppy", Config, ()
    driver = f"{__name__}:Sloppy"


MODEL = SloppyModel
"""


@pytest.mark.long
def test_kinds_that_are_not_meant_are_left_out(pytester, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pytester.makepyfile(test_contract='from hil.pytest_plugin.contract import *\nKINDS = ("tracker",)')
    result = pytester.runpytest_subprocess("--collect-only", "-q")
    tests = [line for line in result.outlines if "::" in line]
    assert tests
    assert all("tracker" in line for line in tests)


CELLS = """
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hil.config.device import DeviceConfig
from hil.fakes.emulated_device import Wired
from hil.core.errors import DeviceError
from hil.core.geometry import Array
from hil.core.interfaces import Sensor
from hil.core.device import Connection, DeviceKind, DeviceModel
from hil.core.signals import Stamp, Status


@dataclass(frozen=True)
class Cells:
    stamp: Stamp
    volt_v: Array
    temperature_c: Array
    switched: Array
    status: tuple[Status, ...]


class Config(DeviceConfig):
    model: Literal["one"] = "one"


class Driver(Sensor):
    name = "packs"

    def __init__(self, config, clock):
        self.clock, self.is_open, self.seq = clock, False, 0

    def open(self):
        self.is_open = True

    def close(self):
        self.is_open = False

    def identity(self):
        return {"model": "one"} if self.is_open else {}

    def read(self):
        if not self.is_open:
            raise DeviceError("packs", "is closed")
        self.seq += 1
        good = self.seq % 10 > 0
        states = (Status.OK, Status.OK, Status.OK if good else Status.TIMEOUT)
        volts = np.array([3.7, 3.7, 3.7 if good else FALSE])
        t_ns = self.clock.now_ns()
        stamp, switched = Stamp(t_ns, t_ns, self.seq), np.array([True, False])
        return (Cells(stamp, volts, np.full((2, 2), 25.0), switched, states),)


class Model(DeviceModel):
    kind, name, title, config = "packs", "one", "packs", Config
    driver = chip = f"{__name__}:Driver"

    def emulate(self, request):
        return Wired(lambda: Connection(), lambda: None)


class Packs(DeviceKind):
    name, noun, sample, models, labels = "packs", "battery", Cells, (Model(),), ("a", "b", "c")


KIND = Packs
"""
BESIDE = """
import pytest

from hil.core.signals import Status
from hil.pytest_plugin.contract import *

KINDS = ("packs", "imu")


@pytest.mark.needs("packs", "imu")
@pytest.mark.fault("imu", "off", at=0.1)
def test_of_my_own(bench):
    records = bench.observe(0.5).records
    assert records[-1].inputs.of("packs")
    assert all(s.status is Status.TIMEOUT for s in records[-1].inputs.of("imu"))
"""


def suite(package, pytester, monkeypatch, missing, model):
    """Lines of the tests that failed of both kinds and of that own one, and how many passed."""
    folders = [
        package("hil-packs", CELLS.replace("FALSE", missing), "KIND"),
        package("hil-sloppy", SLOPPY, "MODEL"),
    ]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, (ROOT, *folders))))
    pytester.makefile(
        ".toml",
        bench='schema = 1\nname = "lab"\n\n[packs]\nbackend = "emulated"\n\n[imu]\nbackend = "emulated"\n'
        f'model = "{model}"\n',
    )
    pytester.makeini("[pytest]\nhil_bench = bench.toml\n")
    pytester.makepyfile(test_contract=BESIDE)
    result = pytester.runpytest_subprocess("-k", "virtual or of_my_own")
    failed = [line.split("::")[1] for line in result.outlines if line.startswith("FAILED")]
    return failed, result.parseoutcomes()["passed"]


def test_broken_promises_are_reported_one_by_one_and_a_device_that_keeps_them_passes(
    package, pytester, monkeypatch
):
    """An array with another shape than the channels' is judged by all of them; a bench of its own is open."""
    failed, passed = suite(package, pytester, monkeypatch, "np.nan", "sloppy")
    assert {line.split("[")[0] for line in failed} == {
        "test_a_read_never_waits_for_the_next_sample",
        "test_a_sample_is_delivered_once",
        "test_reading_a_closed_device_is_a_named_error",
        "test_samples_arrive_in_order_with_stamps_that_make_sense",
        "test_the_doctor_finds_no_failure",
        "test_the_same_seed_gives_the_same_samples",
        "test_each_declared_fault_changes_something",
    }
    assert len(failed) == 7
    assert not any("packs" in line for line in failed)
    assert passed == 14 + 6


@pytest.mark.long
def test_a_number_of_a_channel_that_did_not_answer_is_found(package, pytester, monkeypatch):
    failed, _ = suite(package, pytester, monkeypatch, "0.0", "bno055")
    assert {line.split("[")[0] for line in failed} == {"test_no_data_is_never_a_number"}
