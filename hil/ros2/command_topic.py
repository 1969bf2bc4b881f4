"""The topic from which a program on ROS 2 commands the robot: joints, or a velocity of the body.

Messages are passed on unchanged. Messages of all these types are received, whichever the program sends.
"""

import re
from collections.abc import Iterator, Sequence, Set
from typing import Any

import numpy as np

from hil.core.clock import NS_PER_S, MonotonicClock, seconds
from hil.core.errors import UsageError
from hil.core.external_commands import ExternalCommand
from hil.recording.rosbags_adapter import from_cdr
from hil.ros2.participant import Participant
from hil.ros2.publishers import Publisher

JOINTS = "sensor_msgs/msg/JointState"
TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
TYPES = (JOINTS, *TWISTS)
_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
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
        participant: participant on ROS 2.
        topic: its name, with a slash.
        reliable: True to require reliable delivery; best-effort writers do not match then.
        types: types of messages that are received.

    Attributes:
        name: name of the topic.
        where: topic, types and network, in words.
    """

    def __init__(
        self, participant: Participant, topic: str, *, reliable: bool = False, types: Sequence[str] = TYPES
    ) -> None:
        check_topic(topic)
        self._participant, self.name, self._types = participant, topic, types
        self._readers = {kind: participant.add_reader(topic, kind, reliable=reliable) for kind in types}
        self._arrival: Any = participant.wait_set(list(self._readers.values()))
        self._clock = MonotonicClock()
        self._received_ns: dict[int, int] = {}
        names = " or ".join(kind.replace("/msg/", "/") for kind in types)
        self.where = f"ros2:{topic}, {names}, {participant.network.in_words()}"

    def publishers(self) -> Set[int]:
        """Handles of the present writers of all types."""
        return {handle for reader in self._readers.values() for handle in reader.writers()}

    def described(self) -> list[Publisher]:
        """The present writers with their descriptions from DDS."""
        return list(self._participant.publishers(self._readers))

    def silent_s(self, handle: int) -> float | None:
        """Time since a publisher's last message was taken, of the host's clock; None if none was."""
        received_ns = self._received_ns.get(handle)
        return None if received_ns is None else seconds(self._clock.now_ns() - received_ns)

    def types(self) -> list[str]:
        """Types that are published now."""
        return [kind for kind, reader in self._readers.items() if reader.writers()]

    def wait(self, for_ns: int) -> None:
        """Wait until a message has arrived, at most `for_ns`."""
        self._arrival.wait(max(0, for_ns))

    def take(self) -> list[tuple[str, bytes]]:
        """Type and bytes of messages since the last call, in order within each type; never blocks."""
        taken = [(kind, *sample) for kind, reader in self._readers.items() for sample in reader.take()]
        if taken:
            now_ns = self._clock.now_ns()
            self._received_ns.update((writer, now_ns) for _, writer, _ in taken)
        return [(kind, data) for kind, _, data in taken]

    def publishers_text(self) -> str:
        """Publishers in words: number, names, and time since the last command of each."""
        found = self.described()
        if not found:
            return "no publisher any more"
        each = []
        for one in found:
            silent_s = self.silent_s(one.handle)
            last = "no command yet" if silent_s is None else f"last command {silent_s:.1f} s ago"
            each.append(f"{one}, {last}")
        lease_s = max((one.lease_s for one in found if one.lease_s is not None), default=None)
        killed = "" if lease_s is None else f"; one that was killed counts for up to {lease_s:g} s"
        return f"{len(found)} publisher{'s' * (len(found) > 1)}: {'; '.join(each)}{killed}"

    def several_message(self) -> str:
        """Message about several publishers: which there are, and that only one may stay."""
        return f"{self.name} has {self.publishers_text()}; end all but one"

    def silent_message(self) -> str:
        """Message about silent publishers: which they are, and what to check."""
        return (
            f"{self.where} has {self.publishers_text()}; look whether it runs, and what it waits for; for "
            "ros2_control's topic-based hardware set trigger_joint_command_threshold to -1"
        )

    def none_message(self) -> str:
        """Message about a missing publisher: where it is expected, what else is published, what to check."""
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
        """Close the readers. Idempotent; never raises."""
        self._arrival = None
        for reader in self._readers.values():
            reader.close()


def commands_of(messages: Sequence[tuple[str, bytes]], t_ns: int, wall_ns: int) -> Iterator[ExternalCommand]:
    """Decode the commands in messages.

    Args:
        messages: types and bytes.
        t_ns: time at which they came, bench clock.
        wall_ns: ROS time at the bench clock's zero.

    Raises:
        ValueError: a message holds no valid command.
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
