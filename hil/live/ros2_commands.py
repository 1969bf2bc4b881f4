"""Velocity commands from a ROS 2 topic: `geometry_msgs/Twist` or `TwistStamped`, as `/cmd_vel` carries them.

What the robot cannot mean stops it by name: a number that is not finite, a motion off its plane, a second
publisher. A publisher that falls silent is one that nobody hears: `hil.live.velocity_reference` brings the
robot to rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NoReturn

import numpy as np

from hil.core.errors import SafetyStop
from hil.core.external_commands import ExternalCommand
from hil.live.velocity_input import CommandLines
from hil.ros2.command_topic import ALL_BUT_ONE, CommandTopic, commands_of

_REASON = "ros2_command"


class TwistCommands(CommandLines):
    """Commands of the one publisher of a topic.

    Args:
        topic: messages of either type are taken.
    """

    def __init__(self, topic: CommandTopic) -> None:
        self._topic, self.where, self._taken = topic, topic.where, 0

    def pending(self) -> list[str]:
        """Commands that have arrived since the last call, oldest first; never blocks.

        Raises:
            SafetyStop: two publishers, or a command that the robot cannot mean.
        """
        publishers = self._topic.publishers()
        if publishers > 1:
            self._stop(f"has {publishers} publishers", ALL_BUT_ONE)
        lines = [self._line(command) for command in commands_of(self._topic.take(), 0, 0)]
        self._taken += len(lines)
        return lines

    def counts(self) -> Mapping[str, int]:
        """Messages that were taken."""
        return {"messages": self._taken}

    def close(self) -> None:
        """The topic is closed by its owner."""

    def _line(self, command: ExternalCommand) -> str:
        if command.kind != "twist":
            self._stop("sent joint commands after velocities", "end the session to drive otherwise")
        ahead, left, up, roll, pitch, turn = command.velocity_rad_s.tolist()
        if not np.isfinite(command.velocity_rad_s).all():
            self._stop("sent a number that is not finite", "mend the controller")
        if up or roll or pitch:
            self._stop(
                "asks for a motion off the wall (linear.z, angular.x or angular.y is not 0)",
                "send linear.x, linear.y and angular.z",
            )
        return f"v {float(ahead)!r} {float(left)!r} {float(turn)!r}"

    def _stop(self, what: str, remedy: str) -> NoReturn:
        raise SafetyStop(_REASON, f"{self._topic.name} {what}; {remedy}")
