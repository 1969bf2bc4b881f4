"""A body that moves as a test says, an emulated camera on it and a driver on its pipeline."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from hil.config.tracker import T265Config
from hil.drivers.tracker import T265Tracker
from hil.fakes.fault import parse_fault
from hil.fakes.faults import FaultPlan
from hil.fakes.plant_api import Plant, PlantState
from hil.fakes.tracker import IDEAL, T265
from hil.fakes.world import VirtualClock, World


class TravellingPlant:
    """Drives a circle (or a line) with a constant body twist from a given pose."""

    body, steering_rad = Plant.body, Plant.steering_rad

    def __init__(self, twist=(0.05, 0.02, 0.1), start=(0.3, -0.2, 0.5), tilt_rad=math.pi / 2):
        self.t_ns, self.tilt_rad = 0, tilt_rad
        self.start, self.twist = np.array(start, float), np.array(twist, float)

    def command(self, joint, command):
        raise AssertionError("a camera commands nothing")

    def advance(self, t_ns):
        self.t_ns = t_ns

    def joints(self):
        return np.zeros(8), np.zeros(8), np.zeros(8)

    def pose(self, t_ns):
        vx, vy, w = self.twist
        x, y, th = self.start
        t = t_ns * 1e-9
        a = w * t
        sin, cos = (t, 0.0) if w == 0 else (math.sin(a) / w, (1 - math.cos(a)) / w)
        dx, dy = vx * sin - vy * cos, vy * sin + vx * cos
        c, s = math.cos(th), math.sin(th)
        return np.array([x + c * dx - s * dy, y + s * dx + c * dy, th + a])

    def truth(self):
        return PlantState(
            self.t_ns,
            self.pose(self.t_ns),
            self.twist.copy(),
            np.zeros(2),
            *(np.zeros(8) for _ in range(3)),
            np.zeros(4),
            np.full(4, 8.0),
            np.zeros((4, 2)),
            self.tilt_rad,
            False,
        )


@pytest.fixture
def travelling_plant():
    return TravellingPlant


@pytest.fixture
def tracker_bench():
    """Factory of a world, a camera and an unopened driver in virtual time."""
    drivers = []

    def build(*faults, plant=None, config=None, options=IDEAL, seed=1, **camera_options):
        plant = plant if plant is not None else TravellingPlant()
        world = World(plant, seed=seed, faults=FaultPlan([parse_fault(spec) for spec in faults]))
        settings = T265Config(**{"backend": "emulated", **(config or {})})
        camera = T265(
            world,
            options=options,
            mount_position_m=settings.mount_position_m,
            mount_rotation_wxyz=settings.mount_rotation_wxyz,
            **camera_options,
        )
        world.faults.check()
        clock = VirtualClock(world)
        driver = T265Tracker(settings, clock, pipeline=camera.pipeline())
        drivers.append(driver)
        return SimpleNamespace(
            plant=plant, world=world, camera=camera, clock=clock, driver=driver, config=settings
        )

    yield build
    for driver in drivers:
        driver.close()


@pytest.fixture
def follow():
    """Reads the driver every 10 ms for some seconds of bench time."""

    def collect(bench, duration_s, period_ns=10_000_000):
        samples, t_ns = [], bench.clock.now_ns()
        end_ns = t_ns + round(duration_s * 1e9)
        while t_ns < end_ns:
            t_ns += period_ns
            bench.clock.sleep_until_ns(t_ns)
            samples += bench.driver.read()
        return samples

    return collect
