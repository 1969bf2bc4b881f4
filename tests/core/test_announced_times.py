"""Parts of the world that say when they are due act as if they were asked before every step."""

import numpy as np

import hil
from hil.core.errors import HilError
from hil.core.signals import ServoSetpoint
from hil.fakes.world import World
from tests.to_the_bit import bits

SECONDS, RATE_HZ = 0.8, 50
FAULTS = (
    "imu:reset@0.2",
    "imu:slow@0.5",
    "tracker:unplug@0.3+0.2",
    "mocap:off@0.2+0.3",
    "adhesion:off@0.4+0.1",
)


def reported(bench_name, faults):
    """Everything that the devices of a bench say in a while, and how the world's clock stood."""
    seen = []
    with hil.open_bench(bench_name, seed=3, faults=faults) as bench:
        actuators, deadline_ns = bench.rig.actuators(), bench.clock.now_ns()
        actuators.enable()
        for k in range(round(SECONDS * RATE_HZ)):
            bench.clock.sleep_until_ns(deadline_ns)
            try:
                seen.append(bits(bench.rig.read(k)))
                actuators.command(ServoSetpoint(np.full(4, 0.02 * k), np.full(4, 0.002 * k)))
            except HilError as error:
                seen.append(str(error))
            seen.append(str(bench.clock.now_ns()))
            deadline_ns += 1_000_000_000 // RATE_HZ
    return seen


def test_telling_and_being_asked_are_the_same(monkeypatch):
    telling = reported("emulated_delivered", FAULTS)
    add = World.add

    def add_to_be_asked(self, part):
        part.announces = False
        add(self, part)

    monkeypatch.setattr(World, "add", add_to_be_asked)
    assert reported("emulated_delivered", FAULTS) == telling
