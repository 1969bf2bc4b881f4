"""A plant of eight first-order joints, and a packet-level client on a bus that drives it."""

import math

import numpy as np

from hil.fakes.body_interface import JointCommand, Plant, PlantState
from hil.fakes.servos.dynamixel.chip import ServoBus
from hil.fakes.servos.dynamixel.true_parameters import ServoBusOptions
from hil.fakes.world import World
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan

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
            self._t_ns += STEP_NS if self._moves() else STEP_NS * ((t_ns - self._t_ns) // STEP_NS)

    def _moves(self):
        """Whether the next step would change anything."""
        places = self.position.tolist()
        return self.velocity.any() or any(map(self._wanted, self.commands, places))

    def _step(self):
        """One step in plain numbers; eight joints are too few for arrays."""
        position, velocity = self.position.tolist(), self.velocity.tolist()
        for joint, command in enumerate(self.commands):
            before, goal = velocity[joint], self._wanted(command, position[joint])
            velocity[joint] = goal + (before - goal) * self._decay
            position[joint] += 0.5 * (before + velocity[joint]) * STEP_NS * 1e-9
        self.position[:], self.velocity[:] = position, velocity
        self.current[:] = 0.05 * np.sign(self.velocity) + self.load_a

    def _wanted(self, command, position):
        if command.mode == "velocity":
            wanted = command.goal
        elif command.mode == "position":
            wanted = POSITION_GAIN * (command.goal - position)
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
            self._t_ns,
            np.zeros(3),
            np.zeros(3),
            np.zeros(2),
            *copies,
            self.position[4:].copy(),
            np.full(4, 8.0),
            np.zeros((4, 2)),
            math.pi / 2,
            False,
        )


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


def make_wire(*faults, options=None, seed=1, **option_values):
    """A bus and a packet-level client on it."""
    world = World(JointPlant(), seed=seed, faults=FaultPlan([parse_fault(f) for f in faults]))
    bus = ServoBus(world, options=options or ServoBusOptions(**option_values))
    world.faults.declare(bus.name, bus.supported_faults)
    world.faults.check()
    return Wire(world, bus)
