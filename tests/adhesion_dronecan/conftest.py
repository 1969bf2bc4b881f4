"""A world with a fan that speaks DroneCAN, and a client's bus."""

import math
from contextlib import contextmanager
from types import SimpleNamespace

import can
import numpy as np
import pytest

from hil.config.dronecan import DroneCanConfig
from hil.config.robot import RobotConfig
from hil.drivers.adhesion.dronecan.driver import DroneCanFan
from hil.fakes.adhesion.dronecan.chip import DroneCanNode, DroneCanTruthOptions
from hil.fakes.can_channel import CanChannel
from hil.fakes.motor_controllers.daemon_in_world import DaemonInWorld
from hil.fakes.plant import make_plant
from hil.fakes.world import VirtualClock, World
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan

CHANNEL = "dronecan"


@contextmanager
def made(*, faults=(), nodes=((42, 0),), **options):
    plan = FaultPlan([parse_fault(spec) for spec in faults])
    plant = make_plant(
        RobotConfig(), rng=np.random.default_rng(0), randomise_truth=False, faults=plan, by_hand=True
    )
    world = World(plant, seed=0, faults=plan)
    channel = CanChannel(world, CHANNEL, device="adhesion").open()
    reported = DroneCanTruthOptions(**{"start": "off", **options})
    fans = [
        DroneCanNode(
            world, channel, DroneCanConfig(node_id=node_id, esc_index=index), reported, f"adhesion{n or ''}"
        )
        for n, (node_id, index) in enumerate(nodes)
    ]
    bus = can.Bus(interface="hil", channel=CHANNEL)
    try:
        node = fans[0] if fans else None
        yield SimpleNamespace(world=world, clock=VirtualClock(world), node=node, bus=bus, channel=channel)
    finally:
        bus.shutdown()
        channel.close()


@pytest.fixture
def fan_world():
    return made


@pytest.fixture
def driver():
    """Makes drivers, which are closed at the end."""
    opened = []

    def make(clock, **keys):
        opened.append(
            DroneCanFan(
                DroneCanConfig(interface="hil", channel=CHANNEL, **keys),
                clock,
                DaemonInWorld(clock._world).commander,
            )
        )
        return opened[-1]

    yield make
    for fan in opened:
        fan.close()


@pytest.fixture
def after():
    """What a driver reads in so many seconds at 100 Hz."""

    def read(fan, clock, seconds):
        samples = []
        for _ in range(math.ceil(100 * seconds)):
            samples += fan.read()
            clock.sleep_until_ns(clock.now_ns() + 10_000_000)
        return samples

    return read
