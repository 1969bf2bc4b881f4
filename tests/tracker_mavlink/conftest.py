"""A body that moves as a test says, an emulated computer on it, and a driver; or a sender by hand."""

import math
from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest
from travelling_plant import TravellingPlant

from hil.config.mavlink import MavlinkTrackerConfig
from hil.drivers.tracker.mavlink.driver import MavlinkTracker
from hil.fakes.tracker.mavlink.chip import IDEAL, VisualInertialComputer
from hil.fakes.tracker.mavlink.links import ComputerLink
from hil.fakes.world import VirtualClock, World
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan
from hil.links.mavlink.transport_interface import Arrival, Link

NAN = math.nan


@pytest.fixture
def travelling_plant():
    return TravellingPlant


@pytest.fixture
def mavlink_bench():
    """Factory of a world, a computer and an unopened driver in virtual time."""
    drivers = []

    def build(*faults, plant=None, config=None, options=IDEAL, seed=1):
        plant = plant if plant is not None else TravellingPlant()
        world = World(plant, seed=seed, faults=FaultPlan([parse_fault(spec) for spec in faults]))
        settings = MavlinkTrackerConfig(**{"backend": "emulated", **(config or {})})
        computer = VisualInertialComputer(
            world,
            options=options,
            mount_position_m=settings.mount_position_m,
            mount_rotation_wxyz=settings.mount_rotation_wxyz,
        )
        world.faults.check()
        clock = VirtualClock(world)
        driver = MavlinkTracker(settings, clock, link=ComputerLink(computer))
        drivers.append(driver)
        return SimpleNamespace(
            plant=plant, world=world, computer=computer, clock=clock, driver=driver, config=settings
        )

    yield build
    for driver in drivers:
        driver.close()


class ScriptedLink(Link):
    """A link whose other end is the test: what `arrive` is given has arrived, what was sent is kept."""

    datagrams, peer, trouble, overflowed = True, None, "", 0

    def __init__(self, clock, common, source=(1, 197)):
        self.clock, self.common = clock, common
        self.writer = common.MAVLink(None, srcSystem=source[0], srcComponent=source[1])
        self.coming, self.sent, self.closed = deque(), [], 0
        self.heard = common.MAVLink(None)

    def arrive(self, *messages, raw=b"", source=None, at_ns=None):
        arrived_ns = self.clock.now_ns() if at_ns is None else at_ns
        for message in messages:
            writer = self.writer
            if source is not None:
                writer = self.common.MAVLink(None, srcSystem=source[0], srcComponent=source[1])
            self.coming.append(Arrival(bytes(message.pack(writer)), arrived_ns, ("10.0.0.2", 14555)))
            self.writer.seq = (self.writer.seq + (source is None)) % 256
        if raw:
            self.coming.append(Arrival(raw, arrived_ns, ("10.0.0.3", 1)))

    def send(self, data, address):
        self.sent += [(m, address) for m in self.heard.parse_buffer(data)]

    def receive(self):
        return self.coming.popleft() if self.coming else None

    def close(self):
        self.closed += 1


@pytest.fixture
def common():
    return pytest.importorskip("pymavlink.dialects.v20.common", reason="the extra mavlink is not installed")


@pytest.fixture
def odometry(common):
    """Makes a message by pymavlink itself: a pose in LOCAL_FRD, twist in BODY_FRD, unless asked otherwise."""

    def make(time_s=1.0, **changes):
        fields = {
            "frame_id": 20,
            "child_frame_id": 12,
            "x": 0.0,
            "y": 0.0,
            "z": 0.0,
            "q": [1.0, 0.0, 0.0, 0.0],
            "vx": 0.0,
            "vy": 0.0,
            "vz": 0.0,
            "rollspeed": 0.0,
            "pitchspeed": 0.0,
            "yawspeed": 0.0,
            "pose_covariance": [NAN] + [0.0] * 20,
            "velocity_covariance": [NAN] + [0.0] * 20,
            "reset_counter": 0,
            "estimator_type": 3,
            "quality": 80,
        }
        return common.MAVLink_odometry_message(round(time_s * 1e6), **{**fields, **changes})

    return make


@pytest.fixture
def by_hand(common, odometry):
    """Factory of a driver whose sender is the test; it is opened by a first pose at 1 s of the sender."""

    def build(config=None, *, opened=True, **first):
        clock = VirtualClock(World(TravellingPlant()))
        link = ScriptedLink(clock, common)
        settings = MavlinkTrackerConfig(**(config or {}))
        driver = MavlinkTracker(settings, clock, link=lambda *_: link)
        bench = SimpleNamespace(clock=clock, link=link, driver=driver, config=settings, count=0)

        def send(duration_s=0.1, rate_hz=100, start=(0.0, 0.0, 0.0), step=(1e-3, 0.0, 0.0), **changes):
            """Poses that go on steadily, each read at once; the samples."""
            samples = []
            for k in range(round(duration_s * rate_hz)):
                bench.count += 1
                clock.sleep_until_ns(clock.now_ns() + round(1e9 / rate_hz))
                place = np.add(start, np.multiply(k, step))
                where = dict(zip("xyz", place.tolist(), strict=True))
                link.arrive(odometry(1.0 + clock.now_ns() * 1e-9, **{**where, **changes}))
                samples += driver.read()
            return samples

        bench.send = send
        if opened:
            link.arrive(odometry(1.0, **first))
            driver.open()
        return bench

    return build
