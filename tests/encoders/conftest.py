"""A plant whose steering axes do what a test says, a CAN channel, a node and a driver on it."""

from types import SimpleNamespace

import numpy as np
import pytest
from still_plant import StillPlant

from hil.config.encoders import EncodersConfig
from hil.drivers.encoders.as5045.driver import As5045Encoders
from hil.fakes.can_channel import CanChannel
from hil.fakes.encoders.as5045.chip import EncoderNode
from hil.fakes.encoders.as5045.encoder import EncoderTruthOptions
from hil.fakes.world import VirtualClock, World
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan


class SteeringPlant(StillPlant):
    """Only its steering angles matter: constant plus rate times time."""

    def __init__(self, steering_rad=(0.0, 0.0, 0.0, 0.0), rate_rad_s=0.0):
        super().__init__()
        self.start_rad, self.rate_rad_s = np.array(steering_rad, float), rate_rad_s

    def steering(self):
        return self.start_rad + self.rate_rad_s * self.t_ns * 1e-9

    def moves(self):
        return {"steering_true_rad": self.steering()}


@pytest.fixture
def steering_plant():
    return SteeringPlant


@pytest.fixture
def encoder_bench():
    """Factory; channels are closed afterwards."""
    channels, drivers = [], []

    def build(*faults, plant=None, config=None, options=None, seed=1, wire=None, **node_options):
        world = World(
            plant if plant is not None else SteeringPlant(),
            seed=seed,
            faults=FaultPlan([parse_fault(spec) for spec in faults]),
        )
        channel = CanChannel(world, f"test{len(channels)}").open()
        channels.append(channel)
        node = EncoderNode(
            world,
            wire(channel) if wire else channel,
            options=options or EncoderTruthOptions(),
            **node_options,
        )
        world.faults.check()
        clock = VirtualClock(world)
        settings = {"interface": "hil", "channel": channel.name, "backend": "emulated", **(config or {})}
        driver = As5045Encoders(EncodersConfig(**settings), clock)
        drivers.append(driver)
        return SimpleNamespace(
            plant=world.plant, world=world, channel=channel, node=node, clock=clock, driver=driver
        )

    yield build
    for driver in drivers:
        driver.close()
    for channel in channels:
        channel.close()


@pytest.fixture
def drain():
    def collect(bench, cycles, period_ns=10_000_000):
        samples, t_ns = [], bench.clock.now_ns()
        for _ in range(cycles):
            samples += bench.driver.read()
            t_ns += period_ns
            bench.clock.sleep_until_ns(t_ns)
        return samples

    return collect
