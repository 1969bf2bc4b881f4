"""Worlds with a fan on its bus and a client of python-can: what the tests of the emulated fan share."""

import math
from contextlib import contextmanager

import can
import numpy as np

from hil.config.adhesion import VescConfig
from hil.config.robot import RobotConfig
from hil.fakes.can_channel import CanChannel
from hil.fakes.motor_controllers.true_parameters import AdhesionTruthOptions
from hil.fakes.motor_controllers.vesc_node import VescNode
from hil.fakes.plant import make_plant
from hil.fakes.world import VirtualClock, World
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan

ON = {"messages_1": (1,), "messages_2": (4, 5), "start": "off"}
"""Status messages as a commissioned controller sends them, and a fan at rest."""


@contextmanager
def fan_world(name="fan", *, faults=(), config=None, seed=0, **options):
    """A nominal robot in the hand on a wall, and its fan: (world, clock, node, a client's bus)."""
    plan = FaultPlan([parse_fault(spec) for spec in faults])
    plant = make_plant(
        RobotConfig(), rng=np.random.default_rng(seed), randomise_truth=False, faults=plan, by_hand=True
    )
    world = World(plant, seed=seed, faults=plan)
    config = config or VescConfig()
    channel = CanChannel(world, name, bitrate=config.bitrate, device="adhesion").open()
    node = VescNode(world, channel, config, AdhesionTruthOptions(**options))
    plan.check()
    bus = can.Bus(interface="hil", channel=name)
    try:
        yield world, VirtualClock(world), node, bus
    finally:
        bus.shutdown()
        channel.close()


def send(bus, frame_id, data):
    bus.send(can.Message(arbitration_id=frame_id, data=data, is_extended_id=True))


def duty_frame(duty):
    return round(duty * 1e5).to_bytes(4, "big", signed=True)


def heard(bus):
    """All frames that wait."""
    found = []
    while (message := bus.recv(0)) is not None:
        found.append((message.arbitration_id, bytes(message.data)))
    return found


def keep(bus, clock, seconds, frame_id=1, data=None, duty=0.8):
    """Command a duty every 50 ms."""
    for _ in range(math.ceil(seconds / 0.05)):
        send(bus, frame_id, duty_frame(duty) if data is None else data)
        clock.sleep_until_ns(clock.now_ns() + 50_000_000)


def after(driver, clock, seconds):
    """What a driver reads in so many seconds at 100 Hz."""
    samples = []
    for _ in range(math.ceil(100 * seconds)):
        samples += driver.read()
        clock.sleep_until_ns(clock.now_ns() + 10_000_000)
    return samples


def orders(bus):
    """The SET_* frames that a client overheard."""
    return [(i, d) for i, d in heard(bus) if i >> 8 in (0, 1, 2, 3, 4, 10, 11, 12, 13)]
