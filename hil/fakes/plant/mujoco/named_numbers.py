"""Numbers that MuJoCo's robot needs in addition to `hil.fakes.plant.named_numbers`; SI units."""

from typing import Annotated

from hil.core.named_records import Four, Ints, Record, dtype_of
from hil.fakes.plant.named_numbers import Robot

FourInts = Annotated[Ints, 4]


class Places(Record):
    """Indices of the wheels' joints, motors and contact pairs in MuJoCo's vectors, wheel order."""

    drive_q: FourInts
    drive_v: FourInts
    drive_ctrl: FourInts
    steer_q: FourInts
    steer_v: FourInts
    steer_ctrl: FourInts
    pair: FourInts


class Settled(Record):
    """Numbers that are known after the robot has settled on its wheels.

    Attributes:
        fork_inertia: inertia of the forks about their axes.
        ratio_speed: friction's regularisation (`impratio`) times wheel speed; 0 to use `ratio` at any speed.
        ratio: regularisation of contacts without creep.
        slowest: speed below which the regularisation is constant.
        height: height of the settled body.
    """

    fork_inertia: Four
    ratio_speed: float
    ratio: float
    slowest: float
    height: float


class MujocoRecord(Robot):
    """All numbers of one robot."""

    settled: Settled
    places: Places


ROBOT, PLACES = dtype_of(MujocoRecord), dtype_of(Places)
