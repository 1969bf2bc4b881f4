"""The public contract suite finds a device that does not keep its promises, and passes one that does."""

import os

from installing import ROOT

pytest_plugins = ["pytester"]

SLOPPY = """
from dataclasses import replace
from typing import Literal

import numpy as np

from hil.config.imu import Bno055Config
from hil.devices.imu.bno055 import BNO055
from hil.drivers.imu import Bno055Imu


class Config(Bno055Config):
    model: Literal["sloppy"] = "sloppy"


class Sloppy(Bno055Imu):
    def read(self):
        if self._link is None:
            return ()
        self._clock.sleep_until_ns(self._clock.now_ns() + 100_000_000)
        noise = np.random.default_rng().normal(size=3)
        return tuple(replace(s, gyro_rad_s=s.gyro_rad_s + noise) for s in super().read()) * 2


MODEL = replace(BNO055, name="sloppy", title="sloppy", config=Config, driver=Sloppy, ask=None)
"""
TABLES = 'schema = 1\nname = "lab"\n\n[imu]\nmodel = "sloppy"\nbackend = "emulated"\n'


def test_broken_promises_are_told_one_by_one(package, pytester, monkeypatch):
    folder = package("hil-sloppy", SLOPPY, "MODEL")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, (ROOT, folder))))
    pytester.makefile(".toml", bench=TABLES)
    pytester.makepyfile(test_contract="from hil.pytest_plugin.contract import *")
    result = pytester.runpytest_subprocess("--bench", "bench.toml", "-k", "virtual or bit_for_bit")
    failed = {line.split("::")[1].split("[")[0] for line in result.outlines if line.startswith("FAILED")}
    assert failed == {
        "test_a_read_never_waits_for_the_next_sample",
        "test_a_sample_is_delivered_once",
        "test_reading_a_closed_device_is_a_named_error",
        "test_samples_arrive_in_order_with_stamps_that_make_sense",
        "test_the_same_seed_gives_the_same_samples",
    }


def test_kinds_that_are_not_meant_are_left_out(pytester, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pytester.makepyfile(test_contract='from hil.pytest_plugin.contract import *\nKINDS = ("tracker",)')
    result = pytester.runpytest_subprocess("--collect-only", "-q")
    tests = [line for line in result.outlines if "::" in line]
    assert tests
    assert all("tracker" in line for line in tests)
