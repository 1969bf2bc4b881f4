"""A body on a wall, an emulated capture server and a driver: in virtual time, or over UDP on the loopback."""

import math
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from following import follow
from still_plant import StillPlant

from hil.config.mocap import MocapConfig
from hil.core.clock import MonotonicClock
from hil.drivers.mocap.natnet.driver import NatNetMocap
from hil.fakes.mocap.natnet.chip import NatNetServer
from hil.fakes.mocap.natnet.true_parameters import STILL
from hil.fakes.mocap.natnet.udp import NatNetTransport
from hil.fakes.server import EmulationServer
from hil.fakes.world import VirtualClock, World
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan


class Climber(StillPlant):
    """Moves with a constant velocity and turn rate in the wall frame."""

    def __init__(self, velocity=(0.05, -0.03), start=(0.3, -0.2, 0.5), rate=0.1):
        super().__init__(math.pi / 2)
        self.start = np.array(start, float)
        self.velocity = np.array((*velocity, rate), float)

    def pose(self, t_ns):
        return self.start + self.velocity * t_ns * 1e-9

    def moves(self):
        return {"pose_body_in_wall": self.pose(self.t_ns), "twist_body": self.velocity.copy()}


@pytest.fixture
def climber():
    return Climber


@pytest.fixture
def mocap_bench():
    """Factory of a world, a capture server and an unopened driver in virtual time."""
    drivers = []

    def build(*faults, plant=None, config=None, options=STILL, seed=1, **server_options):
        plant = plant if plant is not None else Climber()
        world = World(plant, seed=seed, faults=FaultPlan([parse_fault(spec) for spec in faults]))
        settings = MocapConfig(**{"backend": "emulated", **(config or {})})
        server = NatNetServer(
            world,
            options=options,
            **{"up_axis": settings.up_axis, "multicast": settings.multicast, **server_options},
        )
        world.faults.check()
        clock = VirtualClock(world)
        driver = NatNetMocap(settings, clock, datagrams=server.datagrams)
        drivers.append(driver)
        return SimpleNamespace(
            plant=plant, world=world, server=server, clock=clock, driver=driver, config=settings
        )

    yield build
    for driver in drivers:
        driver.close()


@pytest.fixture
def watch():
    return follow


@pytest.fixture
def served():
    """Factory of a capture server on UDP ports of the loopback, in a thread; returns its transport."""
    running = []

    def serve(*faults, host="127.0.0.1", **server_options):
        world = World(Climber(), seed=1, faults=FaultPlan([parse_fault(spec) for spec in faults]))
        natnet = NatNetServer(world, options=STILL, **server_options)
        transport = NatNetTransport(natnet, host=host)
        server = EmulationServer(world, MonotonicClock(), {"mocap": transport})
        thread = threading.Thread(target=server.run)
        thread.start()
        running.append((server, thread))
        return transport

    yield serve
    for server, thread in running:
        server.stop()
        thread.join(5)


@pytest.fixture
def settings_of():
    """Driver configuration for a served transport."""

    def make(transport, **values):
        where = transport.endpoint()
        return MocapConfig(**{**where, "fail_after_s": 1.0, "open_timeout_s": 2.0, **values})

    return make
