"""A body that moves as a test says, an emulated camera on it and a driver on its pipeline."""

from types import SimpleNamespace

import following
import pytest
from travelling_plant import TravellingPlant

from hil.config.tracker import T265Config
from hil.drivers.tracker.t265.driver import T265Tracker
from hil.fakes.tracker.t265.chip import T265
from hil.fakes.tracker.true_parameters import IDEAL
from hil.fakes.world import VirtualClock, World
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan


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
    return following.follow
