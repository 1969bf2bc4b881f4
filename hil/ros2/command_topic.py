"""The topic from which a program on ROS 2 commands the robot: joints, or a velocity of the body.

What arrives is passed on as it is. Messages of each type are taken, whichever the program sends.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.errors import UsageError
from hil.core.external_commands import ExternalCommand
from hil.recording.ros_types import from_cdr
from hil.ros2.participant import Participant

JOINTS = "sensor_msgs/msg/JointState"
TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
TYPES = (JOINTS, *TWISTS)
_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
ALL_BUT_ONE = "end all but one; one that was killed counts for up to 20 s more"
"""What to do about several publishers."""
_NOTHING = np.zeros(0)


def check_topic(topic: str) -> None:
    """Raise `UsageError` for what is no name of a ROS 2 topic, with a slash."""
    if not _TOPIC.fullmatch(topic):
        raise UsageError(
            f"--controller ros2:{topic}",
            expected="the name of a ROS 2 topic, for example ros2:/joint_commands",
            remedy="letters, digits and underscores between slashes",
        )


class CommandTopic:
    """Takes the messages of a topic.

    Args:
        participant: on ROS 2.
        topic: its name, with a slash.
        reliable: whether no message may be lost; writers that do not promise that are not heard then.
        types: of messages that are taken.

    Attributes:
        name: of the topic.
        where: topic, types and network, in words.
    """

    def __init__(
        self, participant: Participant, topic: str, *, reliable: bool = False, types: Sequence[str] = TYPES
    ) -> None:
        check_topic(topic)
        self._participant, self.name, self._types = participant, topic, types
        self._readers = {kind: participant.add_reader(topic, kind, reliable=reliable) for kind in types}
        self._arrival: Any = participant.wait_set(list(self._readers.values()))
        names = " or ".join(kind.replace("/msg/", "/") for kind in types)
        self.where = f"ros2:{topic}, {names}, {participant.network.in_words()}"

    def publishers(self) -> int:
        """How many writers there are now, of any of the types."""
        return sum(reader.writers() for reader in self._readers.values())

    def types(self) -> list[str]:
        """Types that are published now."""
        return [kind for kind, reader in self._readers.items() if reader.writers()]

    def wait(self, for_ns: int) -> None:
        """Until something can be taken, at most so long."""
        self._arrival.wait(max(0, for_ns))

    def take(self) -> list[tuple[str, bytes]]:
        """Type and bytes of what has come since the last call, in order within each type; never blocks."""
        return [(kind, data) for kind, reader in self._readers.items() for data in reader.take()]

    def why_nobody(self) -> str:
        """Where a publisher was looked for, and what else is there."""
        found = f"nothing publishes {self.where}"
        others = ", ".join(self._participant.other_types(self.name, self._types))
        if others:
            found += f", but another type is published there: {others}"
        if refused := sum(reader.refused() for reader in self._readers.values()):
            found += (
                f"; {refused} publishers do not match by their quality of service: make them reliable, with "
                "neither deadline nor lease"
            )
        return (
            f"{found}; see that the node has this topic, type and ROS_DOMAIN_ID, a discovery range that is "
            "LOCALHOST or wider (ROS_AUTOMATIC_DISCOVERY_RANGE), and with rmw_cyclonedds of Humble set "
            "ROS_LOCALHOST_ONLY=1 there"
        )

    def close(self) -> None:
        """Let go. Idempotent; never raises."""
        self._arrival = None
        for reader in self._readers.values():
            reader.close()


def commands_of(messages: Sequence[tuple[str, bytes]], t_ns: int, wall_ns: int) -> Iterator[ExternalCommand]:
    """Commands that messages hold.

    Args:
        messages: types and bytes.
        t_ns: when they came, bench clock.
        wall_ns: ROS time at the bench clock's zero.

    Raises:
        ValueError: one holds none.
    """
    for kind, data in messages:
        message = from_cdr(data, kind)
        stamp_ns = None
        if (header := getattr(message, "header", None)) is not None:
            ros_ns = header.stamp.sec * NS_PER_S + header.stamp.nanosec
            stamp_ns = ros_ns - wall_ns if ros_ns else None
        if kind == JOINTS:
            columns = (
                np.array(c, dtype=np.float64) for c in (message.position, message.velocity, message.effort)
            )
            yield ExternalCommand(t_ns, stamp_ns, "joints", tuple(message.name), *columns)
        else:
            twist = getattr(message, "twist", message)
            along, about = twist.linear, twist.angular
            six = np.array([along.x, along.y, along.z, about.x, about.y, about.z])
            yield ExternalCommand(t_ns, stamp_ns, "twist", (), _NOTHING, six, _NOTHING)
