"""The interface between emulated chips and the robot body: joint commands in, physical truth out.

Joints are numbered 0..7: drives FL, BL, BR, FR, then steers FL, BL, BR, FR (`hil.core.signals.SERVOS`).
"""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

from hil.core.geometry import Array

JointMode = Literal["off", "velocity", "position", "pwm", "current"]


class JointCommand(NamedTuple):
    """Set-point that a servo's firmware gives to its motor.

    Attributes:
        mode: closed loop to run; `off` removes the torque.
        goal: set-point in rad/s, rad, duty -1..1 or A, depending on the mode.
        velocity_limit_rad_s: profile or register limit; `inf` for none.
        current_limit_a: current limit; `inf` for none.
        pwm_limit: largest duty, 0..1.
    """

    mode: JointMode = "off"
    goal: float = 0.0
    velocity_limit_rad_s: float = float("inf")
    current_limit_a: float = float("inf")
    pwm_limit: float = 1.0


@dataclass(frozen=True)
class HoldingForces:
    """Forces that hold a robot on its surface besides those of its wheels.

    Attributes:
        adhesion_n: force of the ducted fan towards the surface, at the body's origin.
        thrust_n: force of both propellers along body x.
        fan_gain, propeller_gain: ratio of the true force to the force by the ratings.
    """

    adhesion_n: float
    thrust_n: float
    fan_gain: float = 1.0
    propeller_gain: float = 1.0


@dataclass(frozen=True)
class PlantState:
    """Physical truth at `t_ns`.

    Attributes:
        pose_body_in_wall: (3,) x m, y m, theta rad (unwrapped).
        twist_body: (3,) m/s, m/s, rad/s.
        acceleration_body: (2,) m/s^2, kinematic (no gravity), body axes.
        joint_position_rad, joint_velocity_rad_s, joint_current_a: state of the joints, (8,), multi-turn.
        steering_true_rad: (4,) heading of each wheel beyond backlash and horn offset, body frame.
        normal_load_n: normal load (4,) of each wheel.
        slip_m_s: (4, 2) longitudinal and lateral slip velocity in the wheel frame.
        tilt_rad: tilt of the surface: 0 floor, pi/2 wall.
        fallen: True if the robot has left the wall.
        adhesion_n, thrust_n: present forces of fan and propellers; NaN where unknown.
    """

    t_ns: int
    pose_body_in_wall: Array
    twist_body: Array
    acceleration_body: Array
    joint_position_rad: Array
    joint_velocity_rad_s: Array
    joint_current_a: Array
    steering_true_rad: Array
    normal_load_n: Array
    slip_m_s: Array
    tilt_rad: float
    fallen: bool
    adhesion_n: float = math.nan
    thrust_n: float = math.nan


class BodyMotion(NamedTuple):
    """Planar motion of the body as plain numbers, which most emulated chips read at a high rate.

    Attributes:
        x_m, y_m, theta_rad: pose in the wall frame, heading unwrapped.
        v_x_m_s, v_y_m_s, omega_rad_s: twist, body axes.
        a_x_m_s2, a_y_m_s2: kinematic acceleration (no gravity), body axes.
        tilt_rad: tilt of the surface: 0 floor, pi/2 wall.
    """

    x_m: float
    y_m: float
    theta_rad: float
    v_x_m_s: float
    v_y_m_s: float
    omega_rad_s: float
    a_x_m_s2: float
    a_y_m_s2: float
    tilt_rad: float


class Plant(Protocol):
    """The robot as a physical body. Deterministic; results do not depend on how `advance` is split."""

    @property
    @abstractmethod
    def t_ns(self) -> int:
        """Time up to which the body has been integrated."""

    @abstractmethod
    def command(self, joint: int, command: JointCommand) -> None:
        """Set the set-point of a joint's motor."""

    @property
    def working_point(self) -> HoldingForces | None:
        """True forces of fan and propellers at the working point on a wall that `[robot]` describes.

        On a wall they act from the start until other forces are set. None where the forces are unknown, or
        where the body needs no holding force.
        """
        return None

    def set_adhesion(self, force_n: float) -> None:
        """Set the fan's force from the next internal step on."""
        return

    def set_thrust(self, force_n: float) -> None:
        """Set the propellers' force along body x, with its imbalance, from the next internal step on."""
        return

    @abstractmethod
    def advance(self, t_ns: int) -> None:
        """Integrate up to `t_ns` in whole internal steps; a remainder is left for the next call."""

    @abstractmethod
    def joints(self) -> tuple[Array, Array, Array]:
        """Return position (8,), velocity (8,) and current (8,) as read-only views, not copies."""

    @abstractmethod
    def truth(self) -> PlantState:
        """Return a frozen copy of the whole state."""

    def body(self) -> BodyMotion:
        """Return the motion of the body; some plants give it at a lower cost than `truth`."""
        state = self.truth()
        pose, twist, acceleration = state.pose_body_in_wall, state.twist_body, state.acceleration_body
        return BodyMotion._make((*pose.tolist(), *twist.tolist(), *acceleration.tolist(), state.tilt_rad))

    def adhesion_n(self) -> float:
        """Return the present force of the fan, NaN if unknown; often at a lower cost than `truth`."""
        return self.truth().adhesion_n

    def steering_rad(self) -> list[float]:
        """Return the true heading of each wheel in the body frame, wheel order, like `truth`."""
        return self.truth().steering_true_rad.tolist()  # type: ignore[no-any-return]
