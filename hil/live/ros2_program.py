"""A ROS 2 program in a live session: waits until it publishes; its message type decides how it drives.

Joint commands drive the wheels. Velocities move the reference of the bench's own control law; where a
trajectory is to be followed, they drive the wheels, too. A publisher that is missing, sends nothing, or is
gone causes a warning.
"""

import logging
from collections.abc import Mapping
from typing import NoReturn

from hil.bench import Bench
from hil.bench.bench import Until
from hil.core.clock import NS_PER_S
from hil.core.errors import SafetyStop
from hil.core.external_commands import ExternalCommand
from hil.core.signals import CycleRecord
from hil.live.velocity_input import CommandLines
from hil.recording.runs import RunStart
from hil.ros2.command_exchange import PUBLISHERS
from hil.ros2.command_topic import JOINTS, CommandTopic, commands_of
from hil.ros2.external_controller import COMMAND, body_velocity
from hil.ros2.publisher import Ros2Publisher
from hil.ros2.publishers import Publisher

LOG = logging.getLogger(__name__)
_PATIENCE_S = 5
_NONE = 0
"""Handle that stands for a missing publisher."""


class PublisherWatch:
    """Warns once of each publisher that is missing, silent or gone.

    Args:
        topic: topic from which the commands come.

    Attributes:
        lost: publishers that are gone.
    """

    def __init__(self, topic: CommandTopic) -> None:
        self._topic, self.lost = topic, 0
        self._known: dict[int, Publisher] = {}
        self._since_ns: dict[int, int] = {}
        self._warned: set[int] = set()

    def look(self, t_ns: int) -> None:
        """Check the publishers; to be called in every cycle.

        Args:
            t_ns: present time, bench clock.
        """
        found = self._topic.publishers()
        if found != self._known.keys():
            self._changed()
        silent = [handle for handle in found if self._topic.silent_s(handle) is None]
        if not found and not self._known and not self.lost:
            silent = [_NONE]
        for handle in silent:
            since_ns = self._since_ns.setdefault(handle, t_ns)
            if handle not in self._warned and t_ns - since_ns > _PATIENCE_S * NS_PER_S:
                self._warned.add(handle)
                why = self._topic.silent_message() if handle else self._topic.none_message()
                LOG.warning("no command within %d s: %s", _PATIENCE_S, why)

    def _changed(self) -> None:
        """Store the current publishers, and warn of those that are gone."""
        now = {one.handle: one for one in self._topic.described()}
        for handle in self._known.keys() - now.keys():
            self.lost += 1
            silent_s = self._topic.silent_s(handle)
            last = "without a command" if silent_s is None else f"{silent_s:.1f} s after its last command"
            LOG.warning("%s: %s is gone, %s", self._topic.name, self._known[handle], last)
        self._known = now


class TwistCommands(CommandLines):
    """Velocity commands of the only publisher of a topic.

    Args:
        topic: topic of the commands; may carry messages of either velocity type.
        watch: watch of the publishers of the topic.
    """

    def __init__(self, topic: CommandTopic, watch: PublisherWatch) -> None:
        self._topic, self._watch, self.where, self._taken = topic, watch, topic.where, 0

    def pending(self) -> list[str]:
        """Commands that have arrived since the last call, oldest first; never blocks.

        Raises:
            SafetyStop: two publishers, or an invalid command.
        """
        if len(self._topic.publishers()) > 1:
            raise SafetyStop(PUBLISHERS, self._topic.several_message())
        lines = [self._line(command) for command in commands_of(self._topic.take(), 0, 0)]
        self._taken += len(lines)
        return lines

    def counts(self) -> Mapping[str, int]:
        """Numbers of received messages, and of publishers that are gone."""
        return {"messages": self._taken, "publishers_lost": self._watch.lost}

    def close(self) -> None:
        """Do nothing: the owner of the topic closes it."""

    def _line(self, command: ExternalCommand) -> str:
        if command.kind != "twist":
            self._stop("sent joint commands after velocities", "end the session to drive otherwise")
        ahead, left, turn = body_velocity(command, self._topic.name, "wall").tolist()
        return f"v {ahead!r} {left!r} {turn!r}"

    def _stop(self, what: str, remedy: str) -> NoReturn:
        raise SafetyStop(COMMAND, f"{self._topic.name} {what}; {remedy}")


class Ros2Program:
    """The ROS 2 program that drives a bench.

    Args:
        publisher: publisher of the open bench.
        name: name of the controller, `ros2:TOPIC`.
    """

    def __init__(self, publisher: Ros2Publisher, name: str) -> None:
        assert publisher.commands is not None
        self._publisher, self.name = publisher, name
        self._topic: CommandTopic = publisher.commands
        self._watch = PublisherWatch(self._topic)
        self.where = self._topic.where

    def found(self) -> bool:
        """Whether there is a publisher of its topic now."""
        return bool(self._topic.publishers())

    def sends_joints(self) -> bool:
        """Whether the publisher sends joint commands."""
        return JOINTS in self._topic.types()

    def velocities(self) -> TwistCommands:
        """The velocity commands of the program."""
        return TwistCommands(self._topic, self._watch)

    def counts(self) -> Mapping[str, int]:
        """Numbers of cycles that were shown to it, and of those that it answered in time."""
        exchange = self._publisher.exchange
        return {} if exchange is None else {"cycles": exchange.cycles, "answered_in_time": exchange.answered}

    def look(self, t_ns: int) -> None:
        """Warn of a publisher that is missing, sends nothing, or is gone; to be called in every cycle.

        Args:
            t_ns: present time, bench clock.
        """
        self._watch.look(t_ns)

    def wait(self, bench: Bench, start: RunStart, over: Until) -> None:
        """Keep the robot at rest until the program publishes.

        Args:
            bench: open bench.
            start: state and estimator with which the run begins.
            over: function to True once waiting is to stop.
        """

        def until(record: CycleRecord) -> bool:
            return over(record) or self.found()

        bench.run(bench.make_pipeline(None, feedback=start.feedback), start, until)
