"""Velocity commands from a ROS 2 topic: `geometry_msgs/Twist` or `TwistStamped`, as `/cmd_vel` carries them.

What the robot cannot mean stops it by name: a number that is not finite, a motion off its plane, a second
publisher. A publisher that falls silent counts as silent: `hil.live.velocity_reference` brings the
robot to rest.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from hil.core.clock import NS_PER_S, Clock
from hil.core.errors import SafetyStop, UsageError
from hil.live.velocity_input import CommandLines
from hil.recording.ros_types import from_cdr
from hil.ros2.participant import Participant

LOG = logging.getLogger(__name__)
TYPES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_PATIENCE_NS = 5 * NS_PER_S
_REASON = "ros2_command"


class TwistCommands(CommandLines):
    """Commands of the one publisher of a topic.

    Args:
        participant: on ROS 2.
        topic: its name, with a slash; messages of either type are taken.
        clock: measures the time since the last message.

    Raises:
        UsageError: no name of a topic.
    """

    def __init__(self, participant: Participant, topic: str, clock: Clock) -> None:
        if not _TOPIC.fullmatch(topic):
            raise UsageError(
                f"--controller ros2:{topic}",
                expected="the name of a ROS 2 topic, for example ros2:/cmd_vel",
                remedy="letters, digits and underscores between slashes",
            )
        self._topic, self._clock, self._participant = topic, clock, participant
        self._readers = {kind: participant.add_reader(topic, kind) for kind in TYPES}
        self._alone_ns: int | None = clock.now_ns()
        kinds = " or ".join(kind.rpartition("/")[2] for kind in TYPES)
        self.where = f"ros2:{topic}, geometry_msgs {kinds}, {participant.network.in_words()}"
        self._taken = 0

    def pending(self) -> list[str]:
        """Commands that have arrived since the last call, oldest first; never blocks.

        Raises:
            SafetyStop: two publishers, or a command that the robot cannot mean.
        """
        publishers = sum(reader.writers() for reader in self._readers.values())
        if publishers > 1:
            self._stop(f"has {publishers} publishers", "end all but one")
        self._tell_of_silence(publishers)
        lines = [self._line(kind, data) for kind, reader in self._readers.items() for data in reader.take()]
        self._taken += len(lines)
        return lines

    def counts(self) -> Mapping[str, int]:
        """Messages that were taken."""
        return {"messages": self._taken}

    def close(self) -> None:
        """The participant is closed by its owner."""

    def _line(self, kind: str, data: bytes) -> str:
        message: Any = from_cdr(data, kind)
        twist = getattr(message, "twist", message)
        ahead, left, up = twist.linear.x, twist.linear.y, twist.linear.z
        roll, pitch, turn = twist.angular.x, twist.angular.y, twist.angular.z
        if not np.isfinite([ahead, left, up, roll, pitch, turn]).all():
            self._stop("sent a number that is not finite", "mend the controller")
        if up or roll or pitch:
            self._stop(
                "asks for a motion off the wall (linear.z, angular.x or angular.y is not 0)",
                "send linear.x, linear.y and angular.z",
            )
        return f"v {float(ahead)!r} {float(left)!r} {float(turn)!r}"

    def _tell_of_silence(self, publishers: int) -> None:
        """Say once where the publisher was looked for, when there is none for a while."""
        if publishers:
            self._alone_ns = None
        elif self._alone_ns is not None and self._clock.now_ns() - self._alone_ns > _PATIENCE_NS:
            self._alone_ns = None
            others = ", ".join(self._participant.other_types(self._topic, TYPES))
            LOG.warning(
                "nothing publishes %s%s; see that the node has this topic, type and ROS_DOMAIN_ID, and with "
                "rmw_cyclonedds of Humble set ROS_LOCALHOST_ONLY=1 there",
                self.where,
                f", but another type is published there: {others}" if others else "",
            )

    def _stop(self, what: str, remedy: str) -> None:
        raise SafetyStop(_REASON, f"{self._topic} {what}; {remedy}")
