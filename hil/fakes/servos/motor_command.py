"""Makes a servo's `JointCommand` of torque, operating mode, profile and goals.

Goals are in register counts with the servo's direction and turns; the motor's command is in the joint's
angles. What registers may be written, and when, is the servo's affair.
"""

from __future__ import annotations

import math

from hil.config.servo_models import ServoModel
from hil.config.servo_models.codes import CURRENT, CURRENT_POSITION, EXTENDED, POSITION, PWM, VELOCITY
from hil.fakes.body_interface import JointCommand, Plant
from hil.fakes.servos.control_table import ControlTable
from hil.fakes.servos.profile_trajectory import STEP, Trajectory

_WORD, _HALF_WORD = 1 << 32, 1 << 31


class PositionRegister:
    """Turns encoder counts (joint direction, from joint angle 0) into what the register shows, and back.

    Args:
        model: how the servo counts.
        zero: encoder counts of the chip at joint angle 0.

    Attributes:
        encoder: as last sensed.
        sign: -1 in reverse mode.
        homing: homing offset in force.
    """

    def __init__(self, model: ServoModel, zero: int) -> None:
        self._turn_counts, self._rad_per_count = model.counts_per_turn, model.rad_per_count
        self._zero, self._base = zero, zero
        self.encoder, self.sign, self.homing = 0, 1, 0

    @property
    def present(self) -> int:
        """Present Position; it wraps at 32 bits."""
        return (self.sign * self.encoder + self._base + self.homing + _HALF_WORD) % _WORD - _HALF_WORD

    def wrap(self) -> None:
        """Count from one turn again; a homing offset still applies on top."""
        base = self.sign * self._zero
        turns = (self.sign * self.encoder + base) // self._turn_counts
        self._base = base - turns * self._turn_counts

    def slip(self, counts: int) -> None:
        """The encoder's magnet turns on its shaft."""
        self._zero += counts
        self._base += self.sign * counts

    def joint_rad(self, counts: float) -> float:
        """Joint angle at which the register would show `counts`."""
        return self.sign * (counts - self._base - self.homing) * self._rad_per_count


OFF = JointCommand()
_WITH_POSITION = (POSITION, EXTENDED, CURRENT_POSITION)
_REVERSE, _TIMED = 1, 4
_REVERSE_FIRMWARE, _TIMED_FIRMWARE = 38, 42
_HOMING_IN_POSITION_MODE = 1024
_IN_POSITION, _FOLLOWING = 12, 100


class Axis:
    """Motor of one servo.

    Args:
        joint: index in the plant.
        plant: takes the commands.
        table: the servo's registers; another one comes with `load`.
        zero: encoder counts of the chip at joint angle 0.

    Attributes:
        position: Present Position.
        trajectory: of the latest goal.
        torque: whether the motor is driven.
        mode: operating mode in force.
        tripped: the bus watchdog has stopped it.
        share: how far the joint turns for each radian of the motor: less than 1 where its hub slips.
    """

    def __init__(self, joint: int, plant: Plant, table: ControlTable, zero: int) -> None:
        self._joint, self._plant, self._table = joint, plant, table
        self._model = table.model
        self.position = PositionRegister(table.model, zero)
        self.trajectory = Trajectory(table.model)
        self.torque = self.tripped = False
        self.mode = VELOCITY
        self.share = 1.0
        self._timed = False

    def load(self, table: ControlTable) -> None:
        """Take mode, direction and homing offset from the registers, which stay its own from now on."""
        self._table = table
        firmware, drive_mode = table.get("firmware_version"), table.get("drive_mode")
        self.mode = table.get("operating_mode")
        self._timed = bool(drive_mode & _TIMED) and firmware >= _TIMED_FIRMWARE
        self.position.sign = -1 if drive_mode & _REVERSE and firmware >= _REVERSE_FIRMWARE else 1
        offset, most = table.get("homing_offset"), _HOMING_IN_POSITION_MODE
        self.position.homing = min(max(offset, -most), most) if self.mode == POSITION else offset

    def start_over(self) -> None:
        """Within one turn, at rest, motor free."""
        self.torque = self.tripped = False
        self.forget_turns()
        self._plant.command(self._joint, OFF)

    def forget_turns(self) -> None:
        """Count from one turn again, and rest there."""
        self.position.wrap()
        self._table.put("goal_position", self.position.present)
        self.trajectory.rest(self.position.present)

    def lose_power(self) -> None:
        """The motor is free."""
        self.torque = False
        self._plant.command(self._joint, OFF)

    def trip(self) -> None:
        """Stop and hold."""
        self.tripped = True
        self.trajectory.rest(self.position.present)
        self.drive(stopped=True)

    def advance(self, dt_s: float) -> None:
        """One grid step of a profile."""
        self.trajectory.advance(dt_s)
        self.drive()

    def set_torque(self, on: bool) -> None:
        """Switch the motor; on, it goes from where it is to the goals that stand in the registers."""
        was, self.torque = self.torque, on
        if on and not was:
            if self.mode == POSITION:
                self.position.wrap()
            self.trajectory.rest(self.position.present)
            for name in ("goal_velocity", "goal_position"):
                self.pursue(name, self._table.get(name))
        self.drive()

    def pursue(self, name: str, raw: int) -> None:
        """Make a trajectory of a goal where the mode uses it, and tell the motor."""
        trajectory, mode = self.trajectory, self.mode
        if not self.torque or self._there_already(name, raw):
            return
        get = self._table.get
        if name == "goal_velocity" and mode == VELOCITY:
            trajectory.turn(raw, get("profile_acceleration"), self._timed)
        elif name == "goal_position" and mode in _WITH_POSITION:
            acceleration, velocity = get("profile_acceleration"), get("profile_velocity")
            trajectory.move(raw, acceleration, velocity, self._timed)
        self.drive()

    def _there_already(self, name: str, raw: int) -> bool:
        """Whether a goal is what the motor is being asked for anyway."""
        trajectory = self.trajectory
        if trajectory.ongoing or self.tripped:
            return False
        if name == "goal_velocity" and self.mode == VELOCITY:
            return trajectory.velocity == raw
        return name == "goal_position" and self.mode in _WITH_POSITION and trajectory.position == raw

    def drive(self, stopped: bool = False) -> None:
        """Ask the motor for what mode, goals and trajectory mean."""
        if not self.torque:
            self._plant.command(self._joint, OFF)
            return
        get, mode, sign, model = self._table.get, self.mode, self.position.sign, self._model
        duty = get("goal_pwm") / model.full_pwm
        if mode == VELOCITY:
            goal = sign * self.share * self.trajectory.velocity * model.rad_s_per_count
            command = JointCommand("velocity", goal, pwm_limit=abs(duty))
        elif mode == CURRENT:
            goal = 0.0 if stopped else sign * get("goal_current") * model.a_per_count
            command = JointCommand("current", goal)
        elif mode == PWM:
            command = JointCommand("pwm", 0.0 if stopped else sign * duty)
        else:
            goal = self.position.joint_rad(self.trajectory.position)
            limit_a = abs(get("goal_current")) * model.a_per_count if mode == CURRENT_POSITION else math.inf
            command = JointCommand("position", goal, current_limit_a=limit_a, pwm_limit=abs(duty))
        self._plant.command(self._joint, command)

    def moving_status(self, present: int) -> int:
        """Moving Status (123) at a Present Position."""
        trajectory = self.trajectory
        if self.mode not in _WITH_POSITION:
            return 0
        arrived = not trajectory.ongoing and abs(present - trajectory.position) <= _IN_POSITION
        shape = trajectory.shape << 4 if trajectory.ongoing and trajectory.shape != STEP else 0
        following = abs(present - trajectory.position) > _FOLLOWING
        return int(arrived) | trajectory.ongoing << 1 | following << 3 | shape
