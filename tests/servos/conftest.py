"""Factories: a packet-level client on an emulated bus, and a driver on `hil://servos`."""

from types import SimpleNamespace

import pytest
from servo_wire import JointPlant, make_wire

from hil.config.servos import ServosConfig
from hil.drivers.servos.dynamixel.driver import DynamixelServos
from hil.fakes.serial_line import SerialLine
from hil.fakes.servos.dynamixel.chip import ServoBus
from hil.fakes.servos.dynamixel.true_parameters import ServoBusOptions
from hil.fakes.world import VirtualClock, World
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan


@pytest.fixture
def wire():
    """Factory of a bus and a packet-level client on it."""
    return make_wire


@pytest.fixture
def servo_bench():
    """Factory of a driver on an emulated bus behind an emulated line, in virtual time."""
    lines = []

    def build(*faults, config=None, options=None, seed=1, latency_s=0.001, open_driver=True, **values):
        plant = JointPlant()
        world = World(plant, seed=seed, faults=FaultPlan([parse_fault(f) for f in faults]))
        bus = ServoBus(world, options=options or ServoBusOptions(**values))
        line = SerialLine(world, bus, latency_s=latency_s).open()
        lines.append(line)
        world.faults.check()
        clock = VirtualClock(world)
        settings = {"port": "hil://servos", "backend": "emulated", **(config or {})}
        driver_config = ServosConfig(**settings)
        driver = DynamixelServos(driver_config, clock)
        if open_driver:
            driver.open()
        return SimpleNamespace(
            plant=plant, world=world, bus=bus, line=line, clock=clock, driver=driver, config=driver_config
        )

    yield build
    for line in lines:
        line.close()
