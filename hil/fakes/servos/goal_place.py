"""Where goals are written cycle after cycle: looked at closely once, then known until a change."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal

from hil.config.servo_models.codes import EXTENDED, POSITION, VELOCITY
from hil.fakes.servos.memory import GOALS, ControlTable, Plan

_MOTORS: dict[tuple[str, int], Literal["velocity", "position"]] = {
    ("goal_velocity", VELOCITY): "velocity",
    ("goal_position", POSITION): "position",
    ("goal_position", EXTENDED): "position",
}


@dataclass
class GoalPlace:
    """A range of addresses that is nothing but one goal, as things stand.

    Attributes:
        address: where it begins.
        data: what was written there last.
        name: of the goal's register.
        first: the register's first byte.
        form: how its bytes are read and written.
        low, high: raw counts between which it is taken.
        acceleration, velocity: raw counts of the profile in force.
        motor: how the motor follows this goal alone; None where the mode asks for more, or does not use it.
        duty: at most.
    """

    address: int
    data: bytes
    name: str
    first: int
    form: struct.Struct
    low: int
    high: int
    acceleration: int
    velocity: int
    motor: Literal["velocity", "position"] | None
    duty: float


def goal_place(table: ControlTable, mode: int, plan: Plan, address: int, data: bytes) -> GoalPlace | None:
    """What is to be known about a range that has just been written; None where it is not one goal.

    Args:
        table: of the servo; torque is on.
        mode: operating mode in force.
        plan: registers of the range.
        address: where the range begins.
        data: what has been written.
    """
    (register, _), *more = plan
    bounds = None if more or register.name not in GOALS else table.bounds(register)
    if bounds is None:
        return None
    low, high = bounds
    if register.name == "goal_position" and mode == POSITION:
        low, high = max(low, table.get("min_position_limit")), min(high, table.get("max_position_limit"))
    get, motor = table.get, _MOTORS.get((register.name, mode))
    acceleration, velocity = get("profile_acceleration"), get("profile_velocity")
    duty = abs(get("goal_pwm") / table.model.full_pwm)
    form, first = table.layout.unpack[register.name]
    return GoalPlace(
        address, data, register.name, first, form, low, high, acceleration, velocity, motor, duty
    )
