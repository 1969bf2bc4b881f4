"""A plant of eight first-order joints, and a bench of it: world, bus, line, driver on `hil://servos`."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from hil.config.servos import ServosConfig
from hil.drivers.servos import XH430Servos
from hil.fakes.faults import FaultPlan, parse_fault
from hil.fakes.plant_api import JointCommand, Plant, PlantState
from hil.fakes.serial_line import SerialLine
from hil.fakes.servos import ServoBus, ServoBusOptions
from hil.fakes.world import VirtualClock, World

STEP_NS = 1_000_000
TAU_S = 0.072 / math.log(9.0)
POSITION_GAIN = 25.0
TOP_RAD_S = 4.9


class JointPlant(Plant):
    """First-order joints whose 90-10 % time is 72 ms; exact in steps of 1 ms; `load_a` adds current."""

    def __init__(self):
        self._t_ns = 0
        self.commands = [JointCommand()] * 8
        self.history = [[] for _ in range(8)]
        self.position, self.velocity, self.current = np.zeros(8), np.zeros(8), np.zeros(8)
        self.load_a = np.zeros(8)
        self._decay = math.exp(-STEP_NS * 1e-9 / TAU_S)

    @property
    def t_ns(self):
        return self._t_ns

    def command(self, joint, command):
        self.commands[joint] = command
        self.history[joint].append((self._t_ns, command))

    def advance(self, t_ns):
        while self._t_ns + STEP_NS <= t_ns:
            self._step()
            self._t_ns += STEP_NS

    def _step(self):
        goal = np.array([self._wanted(j, c) for j, c in enumerate(self.commands)])
        before = self.velocity.copy()
        self.velocity[:] = goal + (before - goal) * self._decay
        self.position += 0.5 * (before + self.velocity) * STEP_NS * 1e-9
        self.current[:] = 0.05 * np.sign(self.velocity) + self.load_a

    def _wanted(self, joint, command):
        if command.mode == "velocity":
            wanted = command.goal
        elif command.mode == "position":
            wanted = POSITION_GAIN * (command.goal - self.position[joint])
        elif command.mode == "pwm":
            wanted = 5.0 * command.goal
        elif command.mode == "current":
            wanted = 2.0 * command.goal
        else:
            wanted = 0.0
        top = min(TOP_RAD_S, command.velocity_limit_rad_s)
        return min(max(wanted, -top), top)

    def joints(self):
        return self.position, self.velocity, self.current

    def truth(self):
        copies = (self.position.copy(), self.velocity.copy(), self.current.copy())
        return PlantState(
            self._t_ns, np.zeros(3), np.zeros(3), np.zeros(2), *copies, self.position[4:].copy(),
            np.full(4, 8.0), np.zeros((4, 2)), math.pi / 2, False,
        )  # fmt: skip


class Wire:
    """A client at packet level: sends bytes to the bus at the wire's pace and gathers what is answered."""

    def __init__(self, world, bus, baud=1_000_000):
        self.world, self.bus, self.baud = world, bus, baud

    def send(self, data, wait_ns=3_000_000):
        if isinstance(data, str):
            data = bytes.fromhex(data)
        self.world.advance_to(self.world.now_ns + len(data) * 10_000_000_000 // self.baud)
        self.world.sync_plant()
        self.replies = self.bus.receive(data, self.world.now_ns, self.baud)
        self.world.advance_to(self.world.now_ns + wait_ns)
        self.world.sync_plant()
        return b"".join(r.data for r in self.replies)


@pytest.fixture
def wire():
    """Factory of a bus and a packet-level client on it."""

    def build(*faults, options=None, seed=1, **option_values):
        world = World(JointPlant(), seed=seed, faults=FaultPlan([parse_fault(f) for f in faults]))
        bus = ServoBus(world, options=options or ServoBusOptions(**option_values))
        world.faults.declare(bus.name, bus.supported_faults)
        world.faults.check()
        return Wire(world, bus)

    return build


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
        driver = XH430Servos(driver_config, clock)
        if open_driver:
            driver.open()
        return SimpleNamespace(
            plant=plant, world=world, bus=bus, line=line, clock=clock, driver=driver, config=driver_config
        )

    yield build
    for line in lines:
        line.close()
