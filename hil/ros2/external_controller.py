"""Turns the commands of a ROS 2 program into set-points; stops the robot if they are late or invalid.

The result depends only on the received commands and on the times of the cycles, so that replay repeats it.
Joint commands are in the servos' own angles, as `/joint_states` and `/robot_description` have them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from hil.controller.module_layer import ModuleLayer
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import SafetyStop
from hil.core.external_commands import ExternalCommand, ExternalCommands
from hil.core.geometry import Array
from hil.core.interfaces import ExternalController
from hil.core.known_names import ROS2
from hil.core.signals import DRIVES, SERVOS, STEERS, CycleRecord, WheelMeasurement, WheelSetpoint
from hil.loop.alignment import AlignmentParameters

COMMAND, LATE, CLOCK = "ros2_command", "ros2_late", "ros2_time"
_DRIVES, _STEERS = DRIVES, STEERS
_SYNCHRONISED = (
    "commands do not copy the stamp of /joint_states: this run is synchronised, and need not repeat"
)


@dataclass(frozen=True)
class JointLimits:
    """Limits of joint commands: a command beyond them is rejected, or its steering rate is limited.

    Attributes:
        wheel_rate_rad_s, steering_rad: largest size of a joint's command; a larger one stops the robot.
        steering_rate_rad_s: rate limit of the steering set-points.
        late_after_s: age beyond which a command is too old.
        period_s: period of the loop.
    """

    wheel_rate_rad_s: float
    steering_rad: float
    steering_rate_rad_s: float
    late_after_s: float
    period_s: float


class Ros2Controller(ExternalController):
    """Controller that follows the newest command of a ROS 2 program.

    Args:
        name: `ros2:` and the topic.
        limits: limits of joint commands.
        alignment: signs and zeros of the joints.
        modules: turn velocities of the body into setpoints of the wheels.
    """

    def __init__(
        self, name: str, limits: JointLimits, alignment: AlignmentParameters, modules: ModuleLayer
    ) -> None:
        self.name, self._limits, self._modules = name, limits, modules
        self._topic = name.removeprefix(ROS2)
        self._drive_sign = np.array(alignment.drive_sign, dtype=np.float64)
        self._steer_sign = np.array(alignment.steer_sign, dtype=np.float64)
        self._zero_rad = np.array(alignment.steer_zero_rad, dtype=np.float64)
        self._late_ns = nanoseconds(limits.late_after_s)
        self.ask = _no_program
        self.heard: ExternalCommands | None = None
        self.reset()

    def reset(self) -> None:
        """Reset to the state before a run."""
        self.begun, self.warning = False, ""
        self._modules.reset()
        self._setpoint: WheelSetpoint | None = None
        self._twist: Array | None = None
        self._sent_rad: Array | None = None
        self._command_ns = self._stamp_ns = self._stood_ns = 0

    def update(self, seen: CycleRecord, wheels: WheelMeasurement | None) -> WheelSetpoint | None:
        """Set-point of the newest command; before the first, wheels at rest and measured steering angles."""
        received = self.heard = self.ask(seen)
        if received.reason:
            raise SafetyStop(received.reason, received.trouble)
        for command in received.commands:
            self._take(command)
        if self.begun:
            self._must_be_in_time(seen.inputs.t_ns, received.trouble)
        if received.only_synchronised:
            self.warning = f"{self._topic}: {_SYNCHRONISED}"
        return None if wheels is None else self._decided(wheels)

    def _decided(self, wheels: WheelMeasurement) -> WheelSetpoint:
        if self._twist is not None:
            self._sent_rad = None
            return self._modules.allocate(self._twist, wheels.steering_rad)
        if self._sent_rad is None:
            self._sent_rad = wheels.steering_rad
        if self._setpoint is None:
            return WheelSetpoint(np.zeros(4), self._sent_rad.copy())
        reach_rad = self._limits.steering_rate_rad_s * self._limits.period_s
        step_rad = np.clip(self._setpoint.steering_rad - self._sent_rad, -reach_rad, reach_rad)
        self._sent_rad = self._sent_rad + step_rad
        return WheelSetpoint(self._setpoint.wheel_rate_rad_s.copy(), self._sent_rad.copy())

    def _take(self, command: ExternalCommand) -> None:
        """Check a command, and make it the current one."""
        if command.kind == "twist":
            self._twist, self._setpoint = body_velocity(command, self._topic, "surface"), None
        else:
            self._twist, self._setpoint = None, self._joints(command)
        self._command_ns = command.t_ns
        stamp_ns = command.stamp_ns
        if stamp_ns is None or stamp_ns > self._stamp_ns or not self.begun:
            self._stamp_ns, self._stood_ns = stamp_ns or 0, command.t_ns
        self.begun = True

    def _must_be_in_time(self, t_ns: int, publishers: str) -> None:
        silent_ns = t_ns - self._command_ns
        if silent_ns > self._late_ns:
            self._stop(
                LATE,
                f"has sent no command for {silent_ns / NS_PER_S:.3f} s (ros2.late_after_s)"
                + (f", and has {publishers}" if publishers else ""),
                "look whether the controller runs and keeps up; for ros2_control's topic-based hardware set "
                "trigger_joint_command_threshold to -1, else it sends nothing while nothing changes",
            )
        if self._command_ns - self._stood_ns > self._late_ns:
            stood_s = (self._command_ns - self._stood_ns) / NS_PER_S
            self._stop(
                CLOCK,
                f"has sent commands for {stood_s:.3f} s whose stamps do not go on",
                "look at the controller's clock and at use_sim_time",
            )

    def _joints(self, command: ExternalCommand) -> WheelSetpoint:
        """Steering angles and wheel rates of a joint command, aligned."""
        self._must_be_all(command.names)
        position = self._by_joint(command, "position", command.position_rad, _STEERS)
        velocity = self._by_joint(command, "velocity", command.velocity_rad_s, _DRIVES)
        if len(command.effort):
            self._stop(COMMAND, "commands an effort", "send positions and velocities only")
        steering = self._steer_sign * (np.array([position[name] for name in _STEERS]) - self._zero_rad)
        rates = self._drive_sign * np.array([velocity[name] for name in _DRIVES])
        self._must_be_within(_STEERS, steering, self._limits.steering_rad, "rad", "degrees")
        self._must_be_within(_DRIVES, rates, self._limits.wheel_rate_rad_s, "rad/s", "rpm")
        return WheelSetpoint(rates, steering)

    def _must_be_all(self, names: tuple[str, ...]) -> None:
        """Refuse names that are not those of all joints, once each."""
        wrong = {
            "unknown": [name for name in names if name not in SERVOS],
            "double": sorted({name for name in names if names.count(name) > 1}),
            "missing": [name for name in SERVOS if name not in names],
        }
        found = [f"{what} joint {', '.join(map(repr, some))}" for what, some in wrong.items() if some]
        if found:
            self._stop(COMMAND, f"has sent {'; '.join(found)}", f"name {', '.join(SERVOS)}, in any order")

    def _by_joint(
        self, command: ExternalCommand, what: str, values: Array, joints: tuple[str, ...]
    ) -> Mapping[str, float]:
        """Values by joint name; they are in the order in which `joints` appear among the command's names."""
        if len(values) != len(joints):
            self._stop(
                COMMAND,
                f"has sent {len(values)} values of {what}",
                f"send {len(joints)}, of {', '.join(joints)}, in the order of their names",
            )
        named = zip((n for n in command.names if n in joints), values.tolist(), strict=True)
        found = dict(named)
        for name, value in found.items():
            if not math.isfinite(value):
                self._stop(COMMAND, f"has sent the {what} {value} for {name}", "fix the controller")
        return found

    def _must_be_within(
        self, joints: tuple[str, ...], values: Array, most: float, unit: str, mistaken: str
    ) -> None:
        for name, value in zip(joints, values.tolist(), strict=True):
            if abs(value) > most + 1e-9:
                self._stop(
                    COMMAND,
                    f"asks {name} for {value:.4g} {unit}; its limit is {most:.4g} {unit} either way",
                    f"send {unit}, no {mistaken}, and keep within safety.steering_limit_rad and "
                    "safety.wheel_rate_limit_rad_s",
                )

    def _stop(self, reason: str, what: str, remedy: str) -> NoReturn:
        _stop(self._topic, reason, what, remedy)


def body_velocity(command: ExternalCommand, topic: str, surface: str) -> Array:
    """(3,) body twist of a velocity command: m/s, m/s, rad/s.

    Args:
        command: a twist.
        topic: topic from which it came.
        surface: name of the robot's surface, for the message.

    Raises:
        SafetyStop: it is not finite, or leaves the surface.
    """
    ahead, left, up, roll, pitch, turn = command.velocity_rad_s.tolist()
    if not np.isfinite(command.velocity_rad_s).all():
        _stop(topic, COMMAND, "sent a number that is not finite", "fix the controller")
    if up or roll or pitch:
        _stop(
            topic,
            COMMAND,
            f"asks for a motion off the {surface} (linear.z, angular.x or angular.y is not 0)",
            "send linear.x, linear.y and angular.z",
        )
    return np.array([ahead, left, turn])


def _stop(topic: str, reason: str, what: str, remedy: str) -> NoReturn:
    raise SafetyStop(reason, f"{topic} {what}; {remedy}")


def _no_program(_: CycleRecord) -> ExternalCommands:
    """No commands: the default while no program is attached."""
    return ExternalCommands()
