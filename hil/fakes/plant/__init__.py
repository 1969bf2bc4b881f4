"""The emulated robot body on a floor or wall: rigid body, wheel contacts, servos, falling."""

from hil.fakes.plant.common_body import SteppedBody
from hil.fakes.plant.parameters import TrueParameters
from hil.fakes.plant.recorded_motion import RecordedMotion, RecordedRobot
from hil.fakes.plant.robot import WallRobot, make_plant
from hil.fakes.plant.surfaces import SURFACES, Patch, Surface

__all__ = [
    "SURFACES",
    "Patch",
    "RecordedMotion",
    "RecordedRobot",
    "SteppedBody",
    "Surface",
    "TrueParameters",
    "WallRobot",
    "make_plant",
]
