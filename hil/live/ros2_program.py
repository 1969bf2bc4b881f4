"""A program on ROS 2 in a live session: waited for until it publishes; what it sends decides how it drives.

Joint commands drive the wheels. Velocities move the reference of the bench's own control law; where a
trajectory is to be followed, they drive the wheels, too.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping

from hil.bench import Bench
from hil.bench.bench import Until
from hil.core.clock import NS_PER_S
from hil.core.signals import CycleRecord
from hil.live.ros2_commands import TwistCommands
from hil.recording.runs import RunStart
from hil.ros2.command_topic import JOINTS, CommandTopic
from hil.ros2.publisher import Ros2Publisher

LOG = logging.getLogger(__name__)
_PATIENCE_NS = 5 * NS_PER_S


class Ros2Program:
    """The program that drives a bench.

    Args:
        publisher: the bench is open, and published by it.
        name: of the controller, `ros2:TOPIC`.
    """

    def __init__(self, publisher: Ros2Publisher, name: str) -> None:
        assert publisher.commands is not None
        self._publisher, self.name = publisher, name
        self._topic: CommandTopic = publisher.commands
        self.where = self._topic.where

    def found(self) -> bool:
        """Whether something publishes its topic now."""
        return self._topic.publishers() > 0

    def sends_joints(self) -> bool:
        """Whether the publisher sends joint commands."""
        return JOINTS in self._topic.types()

    def velocities(self) -> TwistCommands:
        """Its velocity commands."""
        return TwistCommands(self._topic)

    def counts(self) -> Mapping[str, int]:
        """Cycles that it was asked in, and those that it answered in time."""
        exchange = self._publisher.exchange
        return {} if exchange is None else {"cycles": exchange.cycles, "answered_in_time": exchange.answered}

    def wait(self, bench: Bench, start: RunStart, over: Until) -> None:
        """Rest until it publishes; a warning says where it is looked for when that takes long.

        Args:
            bench: open.
            start: where the robot stands.
            over: whether to wait no longer.
        """
        begun_ns = bench.clock.now_ns()
        warned = False

        def until(record: CycleRecord) -> bool:
            nonlocal warned
            if over(record) or self.found():
                return True
            if not warned and record.start_ns - begun_ns > _PATIENCE_NS:
                warned = True
                LOG.warning("%s", self._topic.why_none())
            return False

        bench.run(bench.make_pipeline(None, feedback=start.feedback), start, until)
