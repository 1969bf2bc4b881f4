"""What MuJoCo needs of a robot beside the numbers of `hil.fakes.plant.named_numbers`, by name; SI units."""

from __future__ import annotations

from typing import Annotated

from hil.core.named_records import Four, Ints, Record, dtype_of
from hil.fakes.plant.named_numbers import Robot

FourInts = Annotated[Ints, 4]


class Places(Record):
    """Where joints, motors and contact pairs of the wheels stand in MuJoCo's vectors, wheel order."""

    drive_q: FourInts
    drive_v: FourInts
    drive_ctrl: FourInts
    steer_q: FourInts
    steer_v: FourInts
    steer_ctrl: FourInts
    pair: FourInts


class Settled(Record):
    """What is known once the robot stands.

    Attributes:
        fork_inertia: of the forks about their axes.
        ratio_speed: friction's regularisation (`impratio`) times the wheels' speed; 0: `ratio` at any speed.
        ratio: the regularisation of contacts that hold.
        slowest: speed below which the regularisation rises no further.
        height: how high the body stands.
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
