"""A reference that follows velocity commands: bounded, ramped, at rest when commands stop.

The reference is a pose that moves with the commanded velocity, so that the controller also corrects
disturbances by the wall. It depends only on the received lines and on the times at which it is called.
Every cycle record contains it, and replay reads it from there.
"""

import logging

import numpy as np

from hil.core.errors import UsageError
from hil.core.geometry import Array, ArrayLike, compose, rotation2, se2_exp, wrap
from hil.core.signals import Reference
from hil.live.velocity_input import CommandLines, parse_command
from hil.robot.motion_limits import MotionLimits

LOG = logging.getLogger(__name__)

_LONGEST_STEP_S = 0.1
_REPORTED = 5


class VelocityReference:
    """Reference by seconds since the first cycle; to be called once per cycle.

    Args:
        lines: source of the commands.
        start_pose: (3,) pose from which the reference moves.
        projection: P (8, 3) of the wheels, `WheelGeometry.projection()`.
        limits: limits of wheel speed and acceleration, heading and usable surface.
        dead_man_s: age beyond which a command counts as `stop`, with the ramp of the acceleration limit.
        stops_after_s: bus watchdog of the servos: after a longer time without a cycle they stop the wheels,
            and the reference starts again from rest; 0 without a watchdog.

    Attributes:
        accepted, refused: numbers of valid and invalid lines.
        dead_man_stops: number of times that a moving robot was stopped because no command arrived.
    """

    def __init__(
        self,
        lines: CommandLines,
        start_pose: ArrayLike,
        projection: Array,
        limits: MotionLimits,
        *,
        dead_man_s: float = 0.5,
        stops_after_s: float = 0.0,
    ) -> None:
        self._lines, self._projection, self._limits = lines, projection, limits
        self._dead_man_s, self._stops_after_s = dead_man_s, stops_after_s
        self._pose = np.array(start_pose, dtype=np.float64)
        self._twist, self._commanded = np.zeros(3), np.zeros(3)
        self._t_s = self._command_s = 0.0
        self.accepted = self.refused = self.dead_man_stops = 0

    def __call__(self, t_s: float) -> Reference:
        """Process the lines that have arrived, and advance the reference to `t_s`."""
        gone_s = max(t_s - self._t_s, 0.0)
        step_s = min(gone_s, _LONGEST_STEP_S)
        self._t_s = t_s
        if 0.0 < self._stops_after_s < gone_s:
            self._advance(self._stops_after_s)
            self._twist, step_s = np.zeros(3), 0.0
        self._read_commands(t_s)
        before = rotation2(float(self._pose[2])) @ self._twist[:2]
        spin_before = float(self._twist[2])
        self._twist = self._ramped(step_s)
        self._advance(step_s)
        after = rotation2(float(self._pose[2])) @ self._twist[:2]
        acceleration = np.zeros(3)
        if step_s > 0.0:
            acceleration = np.r_[after - before, self._twist[2] - spin_before] / step_s
        return Reference(t_s, self._pose.copy(), self._twist.copy(), acceleration)

    def _read_commands(self, t_s: float) -> None:
        for line in self._lines.pending():
            if not line.strip():
                continue
            try:
                self._commanded = self._within_speed(np.array(parse_command(line)))
            except UsageError as error:
                self.refused += 1
                if self.refused <= _REPORTED:
                    LOG.warning("%s", error)
                continue
            self.accepted += 1
            self._command_s = t_s
            if line.split() == ["stop"]:
                self._twist = np.zeros(3)
        if t_s - self._command_s > self._dead_man_s and self._commanded.any():
            self._commanded = np.zeros(3)
            self.dead_man_stops += 1
            LOG.warning("no command for %.2f s: the robot is stopped", t_s - self._command_s)

    def _peak(self, twist: Array) -> float:
        """Largest contact speed of a wheel, m/s (or m/s^2 of an acceleration)."""
        return float(np.hypot(*(self._projection @ twist).reshape(4, 2).T).max())

    def _within_speed(self, twist: Array) -> Array:
        peak = self._peak(twist)
        return (
            twist if peak <= self._limits.wheel_speed_m_s else twist * (self._limits.wheel_speed_m_s / peak)
        )

    def _ramped(self, step_s: float) -> Array:
        change = self._commanded - self._twist
        peak, reach = self._peak(change), self._limits.wheel_acceleration_m_s2 * step_s
        return self._commanded if peak <= reach else self._twist + change * (reach / peak)

    def _advance(self, step_s: float) -> None:
        """Move the pose; stop if that leads beyond the heading limit or off the usable surface."""
        following = compose(self._pose, se2_exp(self._twist * step_s))
        if self._leaves(following):
            self._twist = np.zeros(3)
            return
        self._pose = following

    def _leaves(self, pose: Array) -> bool:
        limits, now = self._limits, self._pose
        for k, bound in enumerate((limits.x_range_m, limits.y_range_m)):
            if bound is not None and (
                (pose[k] < bound[0] and pose[k] < now[k]) or (pose[k] > bound[1] and pose[k] > now[k])
            ):
                return True
        turned_rad = abs(wrap(float(pose[2])))
        return (
            limits.heading_limit_rad is not None
            and turned_rad > limits.heading_limit_rad
            and turned_rad > abs(wrap(float(now[2])))
        )
