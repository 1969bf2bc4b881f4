"""Computes a servo's `JointCommand` from torque enable, operating mode, profile and goals.

Goals are in register counts with the servo's direction and turns; the motor's command is in joint angles.
`servo.py` checks which registers may be written, and when.

A profile is the trajectory that the firmware generates for a goal: step, ramp, rectangle, triangle or
trapezoid. Velocity-based profiles: Profile Velocity is the top speed, Profile Acceleration the slope;
time-based: total time and acceleration time, in ms. Zero means no limit (e-manual, profile section).
"""

import math

from hil.config.servo_models import ServoModel
from hil.config.servo_models.x_series_codes import (
    CURRENT,
    CURRENT_POSITION,
    EXTENDED,
    POSITION,
    PWM,
    VELOCITY,
)
from hil.fakes.body_interface import JointCommand, Plant
from hil.fakes.servos.dynamixel.control_table import ControlTable

STEP, RECTANGLE, TRIANGLE, TRAPEZOID = 0, 1, 2, 3

_MS = 1e-3
_ARRIVED = 0.05
_WORD, _HALF_WORD = 1 << 32, 1 << 31
OFF = JointCommand()
_WITH_POSITION = (POSITION, EXTENDED, CURRENT_POSITION)
_REVERSE, _TIMED = 1, 4
_REVERSE_FIRMWARE, _TIMED_FIRMWARE = 38, 42
_HOMING_IN_POSITION_MODE = 1024
_IN_POSITION, _FOLLOWING = 12, 100


class Trajectory:
    """Present reference of position (counts) or velocity (velocity counts).

    Args:
        model: model of the servo: gives the units of goals and profiles.

    Attributes:
        position, speed: position counts, and counts per second, of a position trajectory.
        velocity: velocity counts of a velocity trajectory.
        shape: `STEP`, `RECTANGLE`, `TRIANGLE` or `TRAPEZOID` of the latest position goal.
        ongoing: True while the trajectory still changes.
    """

    def __init__(self, model: ServoModel) -> None:
        acceleration = model.table["profile_acceleration"].scale
        self._speed_scale = model.rad_s_per_count / model.rad_per_count
        self._slope_scale = acceleration / model.rad_per_count
        self._ramp_scale = acceleration / model.rad_s_per_count
        self.rest(0.0)

    def rest(self, position: float) -> None:
        """Stop at a position."""
        self.position, self.speed, self.velocity = position, 0.0, 0.0
        self._goal, self._top, self._slope = position, math.inf, math.inf
        self.shape, self.ongoing, self._turning = STEP, False, False

    def turn(self, goal: int, acceleration: int, timed: bool) -> None:
        """Start towards a new velocity goal."""
        self._goal, self._turning, self.shape = float(goal), True, STEP
        if not acceleration:
            self.velocity, self.ongoing = float(goal), False
            return
        change = abs(goal - self.velocity)
        self._slope = change / (acceleration * _MS) if timed else acceleration * self._ramp_scale
        self.ongoing = change > 0.0

    def move(self, goal: int, acceleration: int, velocity: int, timed: bool) -> None:
        """Start towards a new position goal from the present state."""
        self._goal, self._turning = float(goal), False
        distance = abs(goal - self.position)
        if not velocity or distance == 0.0:
            self.position, self.speed = float(goal), 0.0
            self.shape, self.ongoing = STEP, False
            return
        if timed:
            rise = min(acceleration, velocity // 2) * _MS
            self._top = distance / (velocity * _MS - rise)
            # A near goal has a low top speed: a servo that arrives faster must brake within that time, too.
            self._slope = max(self._top, abs(self.speed)) / rise if rise else math.inf
        else:
            self._top = velocity * self._speed_scale
            self._slope = acceleration * self._slope_scale if acceleration else math.inf
        self.ongoing = True
        if math.isinf(self._slope):
            self.shape = RECTANGLE
        else:
            self.shape = TRIANGLE if distance * self._slope < self._top**2 else TRAPEZOID

    def advance(self, dt_s: float) -> None:
        """Follow the profile for `dt_s`."""
        if self._turning:
            step = self._slope * dt_s
            self.velocity += min(max(self._goal - self.velocity, -step), step)
            self.ongoing = self.velocity != self._goal
            return
        left = self._goal - self.position
        before = self.speed
        wanted = self._approach(abs(left), math.copysign(before, before * left), dt_s)
        wanted = math.copysign(min(wanted, self._top), left)
        step = self._slope * dt_s
        self.speed += min(max(wanted - before, -step), step)
        moved = 0.5 * (before + self.speed) * dt_s if math.isfinite(step) else self.speed * dt_s
        if abs(left) <= _ARRIVED or (moved * left > 0 and abs(moved) >= abs(left)):
            self.position, self.speed, self.ongoing = self._goal, 0.0, False
        else:
            self.position += moved

    def _approach(self, left: float, before: float, dt_s: float) -> float:
        """Largest speed at the end of a step from which it can still brake within the remaining distance.

        With v the speed after the step and u before it, v^2 / 2a + (u + v) dt / 2 = left.
        """
        if math.isinf(self._slope):
            return math.inf
        half = 0.5 * self._slope * dt_s
        room = half * half + 2.0 * self._slope * (left - 0.5 * before * dt_s)
        return max(0.0, math.sqrt(room) - half) if room > 0.0 else 0.0


class PositionRegister:
    """Converts between encoder counts (joint direction, from joint angle 0) and Present Position.

    Args:
        model: model of the servo: gives the counts per turn.
        zero: encoder counts of the chip at joint angle 0.

    Attributes:
        encoder: last measured counts.
        sign: sign of the rotation; -1 in reverse mode.
        homing: active homing offset.
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
        """Reduce the position to one turn; a homing offset still applies on top."""
        base = self.sign * self._zero
        turns = (self.sign * self.encoder + base) // self._turn_counts
        self._base = base - turns * self._turn_counts

    def slip(self, counts: int) -> None:
        """Shift the encoder by a slip of its magnet on the shaft."""
        self._zero += counts
        self._base += self.sign * counts

    def joint_rad(self, counts: float) -> float:
        """Joint angle at which Present Position would be `counts`."""
        return self.sign * (counts - self._base - self.homing) * self._rad_per_count


class Axis:
    """Motor control of one servo.

    Args:
        joint: index in the plant.
        plant: plant that receives the commands.
        table: the servo's registers; `load` may replace them.
        zero: encoder counts of the chip at joint angle 0.

    Attributes:
        position: Present Position and its conversion.
        trajectory: trajectory to the latest goal.
        torque: True if the motor is driven.
        mode: active operating mode.
        tripped: True if the bus watchdog has stopped the motor.
        share: joint angle per motor angle: less than 1 while the hub slips.
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
        """Use these registers from now on, and apply their mode, direction and homing offset."""
        self._table = table
        firmware, drive_mode = table.get("firmware_version"), table.get("drive_mode")
        self.mode = table.get("operating_mode")
        self._timed = bool(drive_mode & _TIMED) and firmware >= _TIMED_FIRMWARE
        self.position.sign = -1 if drive_mode & _REVERSE and firmware >= _REVERSE_FIRMWARE else 1
        offset, most = table.get("homing_offset"), _HOMING_IN_POSITION_MODE
        self.position.homing = min(max(offset, -most), most) if self.mode == POSITION else offset

    def start_over(self) -> None:
        """Reset to a position within one turn, at rest, torque off."""
        self.torque = self.tripped = False
        self.forget_turns()
        self._plant.command(self._joint, OFF)

    def forget_turns(self) -> None:
        """Reduce the position to one turn, and stop there."""
        self.position.wrap()
        self._table.put("goal_position", self.position.present)
        self.trajectory.rest(self.position.present)

    def lose_power(self) -> None:
        """Switch the torque off."""
        self.torque = False
        self._plant.command(self._joint, OFF)

    def trip(self) -> None:
        """Stop and hold the position after a bus watchdog timeout."""
        self.tripped = True
        self.trajectory.rest(self.position.present)
        self.drive(stopped=True)

    def advance(self, dt_s: float) -> None:
        """Advance the profile by one step of the grid."""
        self.trajectory.advance(dt_s)
        self.drive()

    def set_torque(self, on: bool) -> None:
        """Switch the torque; when switched on, the motor starts towards the goals in the registers."""
        was, self.torque = self.torque, on
        if on and not was:
            if self.mode == POSITION:
                self.position.wrap()
            self.trajectory.rest(self.position.present)
            for name in ("goal_velocity", "goal_position"):
                self.pursue(name, self._table.get(name))
        self.drive()

    def pursue(self, name: str, raw: int) -> None:
        """Start towards a new goal if the operating mode uses it, and update the motor's command."""
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

    def stands_at(self, name: str, raw: int) -> bool:
        """Whether the motor is driven and a goal is its set-point, so that `pursue` does nothing."""
        return self.torque and self._there_already(name, raw)

    def _there_already(self, name: str, raw: int) -> bool:
        """Return whether a goal is already the motor's set-point."""
        trajectory = self.trajectory
        if trajectory.ongoing or self.tripped:
            return False
        if name == "goal_velocity" and self.mode == VELOCITY:
            return trajectory.velocity == raw
        return name == "goal_position" and self.mode in _WITH_POSITION and trajectory.position == raw

    def drive(self, stopped: bool = False) -> None:
        """Send the motor the command that follows from mode, goals and trajectory."""
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
        """Value of the register Moving Status (123) at a Present Position."""
        trajectory = self.trajectory
        if self.mode not in _WITH_POSITION:
            return 0
        arrived = not trajectory.ongoing and abs(present - trajectory.position) <= _IN_POSITION
        shape = trajectory.shape << 4 if trajectory.ongoing and trajectory.shape != STEP else 0
        following = abs(present - trajectory.position) > _FOLLOWING
        return int(arrived) | trajectory.ongoing << 1 | following << 3 | shape
