"""A small package that adds the kind `thing`, as text, to be spoilt in one place."""

PACKAGE = """
import math
import sys
import time
from collections.abc import Callable
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from hil.config.device import DeviceConfig
from hil.fakes.emulated_device import Wired
from hil.core.geometry import Array
from hil.core.interfaces import Sensor
from hil.core.device import Connection, DeviceKind, DeviceModel
from hil.core.signals import Stamp, Status


@dataclass(frozen=True)
class Sample:
    stamp: Stamp
    value: float
    status: Status = Status.OK
    pair: tuple[float, float] = (1.0, 2.0)
    counts: Array = field(default_factory=lambda: np.zeros(2))
    more: Mapping[str, float] = field(default_factory=dict)
    number: int | None = None


class Config(DeviceConfig):
    model: Literal["one"] = "one"
    port: int = 47000


class Driver(Sensor):
    name = "thing"

    def __init__(self, config, clock):
        self.clock, self.is_open, self.seq = clock, False, 0

    def open(self):
        self.is_open = True

    def close(self):
        self.is_open = False

    def identity(self):
        return {"model": "one"} if self.is_open else {}

    def sample(self, value=1.0, ahead_ns=0, **more):
        self.seq += 1
        t_ns = self.clock.now_ns()
        return Sample(Stamp(t_ns + ahead_ns, t_ns, self.seq), value, **more)

    def read(self):
        return (self.sample(),)


def emulate(setting):
    return Wired(lambda: Connection(), lambda: None)


def thing(driver=Driver, emulate=emulate, **more):
    class One(DeviceModel):
        kind, name, title, config = "thing", "one", "a thing", Config
        driver, chip = f"{__name__}:Driver", f"{__name__}:emulate"

        def make_driver(self, config, clock):
            return driver(config, clock)

        def emulate(self, request):
            return emulate(request)

    for name in ("probe", "search", "truth_options", "connection", "probe_order", "config"):
        if name in more:
            setattr(One, name, more.pop(name))
    named = {"name": "thing", "noun": "thing", "sample": Sample, "models": (One(),)}
    return type("Thing", (DeviceKind,), {**named, **more})()


def varied(item, **values):
    return type(type(item).__name__, (type(item),), values)()


def fail(*given):
    raise RuntimeError("boom")


def endless(driver):
    while True:
        yield driver.sample()
"""
TABLES = """
schema = 1
name = "lab"

[thing]
backend = "emulated"

[imu]
backend = "emulated"
"""
DRIVE = """
from hil.procedure import procedure


@procedure(name="look", needs=("thing",))
def run(ctx):
    with ctx.step("look"):
        ctx.bench.observe(0.1)
"""
CHIP = """
from hil.fakes.emulated_device import Transport
from hil.fakes.world import NEVER_NS, Scheduled


class Chip(Scheduled):
    def __init__(self, world):
        self.at_ns = world.now_ns + 50_000_000

    def next_due_ns(self):
        return self.at_ns

    def on_due(self, t_ns):
        {body}


class Socket(Transport):
    def filenos(self): return []
    def on_readable(self, fd, t_ns): pass
    def endpoint(self): return {{"port": 47000}}
    def close(self): pass
    def next_due_ns(self): return NEVER_NS
    def on_due(self, t_ns): pass


def chip(setting):
    setting.world.add(Chip(setting.world))
    return Wired(lambda: Connection(), Socket)


ITEM = thing(emulate=chip)
"""


CHANNELS = """
@dataclass(frozen=True)
class Two:
    stamp: Stamp
    status: tuple[Status, ...]


class Of(Driver):
    def read(self):
        self.seq += 1
        t_ns = self.clock.now_ns()
        return (Two(Stamp(t_ns, t_ns, self.seq), (Status.OK, Status.FROZEN, Status.OK)),)


ITEM = varied(thing(Of), sample=Two, labels=("left", "right"))
"""
"""A kind of two channels whose driver reports three."""


def driver(body):
    return f"class Bad(Driver):\n    {body}\n\n\nITEM = thing(Bad)\n"
