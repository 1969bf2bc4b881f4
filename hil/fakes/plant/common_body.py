"""Base of all emulated bodies: takes commands and forces, integrates in fixed steps, gives its state.

A command takes effect at the next internal step. `advance` integrates whole steps only, so that results do
not depend on how a period is split.
"""

import math
from abc import abstractmethod
from typing import Any

import numpy as np

from hil.core.errors import UsageError
from hil.core.geometry import Array, ArrayLike
from hil.core.named_records import FLOAT_BYTES, Records, floats, part_of, place
from hil.core.signals import SERVOS
from hil.fakes.body_interface import BodyMotion, HoldingForces, JointCommand, Plant, PlantState
from hil.fakes.plant.named_numbers import (
    MODE_CURRENT,
    MODE_OFF,
    MODE_POSITION,
    MODE_PWM,
    MODE_VELOCITY,
    ROBOT,
)
from hil.fakes.plant.parameters import TrueParameters
from hil.faults.plan import FaultPlan

_MODES = {
    "off": MODE_OFF,
    "velocity": MODE_VELOCITY,
    "position": MODE_POSITION,
    "pwm": MODE_PWM,
    "current": MODE_CURRENT,
}


def _part(path: str) -> slice:
    """Slice of a field in the numbers of a robot's state."""
    dtype, begin = ROBOT["state"], place(ROBOT["state"], path)
    for name in path.split("."):
        dtype = dtype[name]
    return slice(begin, begin + dtype.itemsize // FLOAT_BYTES)


POSE, TWIST, ACCELERATION = (_part(f"origin.{name}") for name in ("pose", "twist", "acceleration"))
ANGLE, RATE, AMPS, HEADING, LOAD, SLIP = map(_part, ("angle", "rate", "amps", "heading", "load", "slip"))
_FALLEN = place(ROBOT["state"], "fallen")
"""Places of what can be seen in the numbers of a robot's state."""


class SteppedBody(Plant):
    """A robot in the records of `hil.fakes.plant.named_numbers`; a derived class integrates it.

    Args:
        parameters: true parameters of the robot.
        robots: array (1,) of `Robot`, or of a record that extends it; constants and state are filled in.
        tilt_rad: tilt of the surface: 0 floor, pi/2 wall, more for overhanging surfaces.
        faults: fault plan; supports `adhesion_loss` of device `plant`, with `factor` (0) of the adhesion
            left, reached linearly within `over_s` (0).
        step_ns: internal step.
        by_hand: True for a robot held by hand, without any motion, until the first motor has torque.
    """

    def __init__(
        self,
        parameters: TrueParameters,
        robots: Records,
        *,
        tilt_rad: float,
        faults: FaultPlan | None,
        step_ns: int,
        by_hand: bool,
    ) -> None:
        self.parameters, self.by_hand = parameters, by_hand
        self.tilt_rad = tilt_rad
        plan = faults if faults is not None else FaultPlan()
        plan.declare("plant", {"adhesion_loss": ("factor", "over_s")})
        self._faults = plan.of("plant")
        self._step_ns, self._steps = step_ns, 0
        self._ahead_ns = step_ns  # before that no step more is whole
        self._robots, robot = robots, robots[0]
        self._state, self._commands, self._constants = robot.state, robot.commands, robot.constants
        self._goals: Any = self._commands.goal.data
        self._commands.rate_limit[:] = self._commands.amps_limit[:] = np.inf
        self._commands.duty_limit[:] = 1.0
        self._settings: list[tuple[str, float, float, float] | None] = [None] * len(SERVOS)
        self._truth: PlantState | None = None
        self._motion = robots["state"]["origin"].view(np.float64)
        self._numbers = floats(robots)[0, part_of(robots.dtype, "state")]
        self._headings = _view(self._state.heading)
        self._views = _view(self._state.angle), _view(self._state.rate), _view(self._state.amps)

    @abstractmethod
    def _integrate(self, n: int, adhesion_factor: float) -> None:
        """Integrate `n` internal steps."""

    def body(self) -> BodyMotion:
        """Motion of the body's origin."""
        x, y, theta, v_x, v_y, omega, a_x, a_y = self._motion.tolist()
        return BodyMotion(x, y, theta, v_x, v_y, omega, a_x, a_y, self.tilt_rad)

    def steering_rad(self) -> list[float]:
        """True heading of each wheel in the body frame, wheel order."""
        return self._headings.tolist()  # type: ignore[no-any-return]

    def adhesion_n(self) -> float:
        """Present force of the fan, N."""
        force_n = float(self._constants.adhesion)
        return force_n if self._faults.empty else force_n * self._adhesion_factor(self._steps)

    @property
    def t_ns(self) -> int:
        """Time up to which the body has been integrated."""
        return self._steps * self._step_ns

    def command(self, joint: int, command: JointCommand) -> None:
        """Set the set-point of a joint's motor from the next internal step on.

        Raises:
            UsageError: no such joint, or a goal or limit that is not a number.
        """
        name, goal, rate_limit, amps_limit, duty_limit = command
        setting, possible = (name, rate_limit, amps_limit, duty_limit), 0 <= joint < 8 and math.isfinite(goal)
        if possible and setting == self._settings[joint]:
            self._goals[joint] = goal
            return
        if not (possible and rate_limit >= 0.0 and amps_limit >= 0.0 and duty_limit >= 0.0):
            raise UsageError(
                f"joint {joint}: {command}", expected="a joint 0..7, a finite goal and limits >= 0"
            )
        q, mode = self._commands, _MODES[name]
        self.by_hand = self.by_hand and mode == MODE_OFF
        if mode != q.mode[joint]:
            self._state.integral[joint] = 0.0
        q.mode[joint] = mode
        q.goal[joint] = goal
        q.rate_limit[joint], q.amps_limit[joint] = rate_limit, amps_limit
        q.duty_limit[joint] = duty_limit if duty_limit < 1.0 else 1.0
        self._settings[joint] = setting

    @property
    def working_point(self) -> HoldingForces:
        """True forces of fan and propellers at their nominal set-points."""
        return self.parameters.working_point

    def set_adhesion(self, force_n: float) -> None:
        """Set the fan's force from the next internal step on.

        Raises:
            UsageError: not a finite force >= 0.
        """
        self._constants.adhesion = _force(force_n, "the fan presses")
        self._truth = None

    def set_thrust(self, force_n: float) -> None:
        """Set the propellers' force along body x from the next internal step on.

        Raises:
            UsageError: not a finite force >= 0.
        """
        self._constants.thrust = _force(force_n, "the propellers push")
        self._constants.thrust_torque = force_n * self.parameters.thrust_lever_m
        self._truth = None

    def advance(self, t_ns: int) -> None:
        """Integrate up to `t_ns` in whole internal steps; a remainder is left for the next call."""
        if t_ns < self._ahead_ns:
            return
        end = t_ns // self._step_ns
        if self.by_hand:
            self._steps = max(end, self._steps)
        elif self._faults.empty:
            self._integrate(end - self._steps, 1.0)
            self._steps = end
        while self._steps < end:
            n, factor = self._stretch(end)
            self._integrate(n, factor)
            self._steps += n
        self._ahead_ns = (end + 1) * self._step_ns

    def _stretch(self, end: int) -> tuple[int, float]:
        """Number of next steps with a constant adhesion factor, and that factor."""
        factor = self._adhesion_factor(self._steps)
        after = self._steps + 1
        while after < end and self._adhesion_factor(after) == factor:
            after += 1
        return after - self._steps, factor

    def _adhesion_factor(self, step: int) -> float:
        fault = self._faults.find("plant", "adhesion_loss", step * self._step_ns)
        if fault is None:
            return 1.0
        return fault.remaining_share(
            step * self._step_ns, fault.option("factor", 0.0), fault.option("over_s", 0.0)
        )

    def joints(self) -> tuple[Array, Array, Array]:
        """Read-only views of position (8,), velocity (8,) and current (8,)."""
        return self._views

    def truth(self) -> PlantState:
        """Return a frozen copy of the state at `t_ns`; cached per internal step."""
        if self._truth is None or self._truth.t_ns != self.t_ns:
            self._truth = self._look()
        return self._truth

    def _look(self) -> PlantState:
        state = self._seen()
        state.setflags(write=False)
        return PlantState(
            self.t_ns,
            state[POSE],
            state[TWIST],
            state[ACCELERATION],
            state[ANGLE],
            state[RATE],
            state[AMPS],
            state[HEADING],
            state[LOAD],
            state[SLIP].reshape(4, 2),
            self.tilt_rad,
            state.item(_FALLEN) != 0.0,
            self.adhesion_n(),
            float(self._constants.thrust),
        )

    def _seen(self) -> Array:
        """Copy of the state's numbers, with all observable values filled in."""
        return self._numbers.copy()


def checked_pose(pose: ArrayLike) -> Array:
    """Return a start pose (3,) as an array; raises `UsageError` for anything else."""
    found = np.asarray(pose, dtype=np.float64)
    if found.shape != (3,) or not np.all(np.isfinite(found)):
        raise UsageError(
            f"start pose {found.tolist()}", expected="three finite numbers: x m, y m, heading rad"
        )
    return found


def _force(force_n: float, doing: str) -> float:
    if not (math.isfinite(force_n) and force_n >= 0.0):
        raise UsageError(f"{doing} with {force_n} N", expected="a finite force >= 0")
    return force_n


def _view(array: Array) -> Array:
    out: Array = array.view()
    out.setflags(write=False)
    return out
