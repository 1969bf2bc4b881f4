"""Publishes the cycles of one bench for the program that drives it, and receives its commands.

In real time the loop waits for a share of the cycle, then continues with the commands that have arrived. In
virtual time it waits for the command that belongs to the cycle; the bench's time stands still meanwhile.
"""

from abc import abstractmethod
from collections.abc import Collection
from typing import Protocol

from hil.config.ros2 import Ros2Config
from hil.core.clock import Clock, nanoseconds
from hil.core.external_commands import ExternalCommands
from hil.core.signals import CycleRecord
from hil.ros2.command_topic import CommandTopic, commands_of

LOCKSTEP, PUBLISHERS, NO_COMMAND = "ros2_lockstep", "ros2_publishers", "ros2_no_command"
"""Reasons to stop."""
_AGAIN_NS = 20_000_000
_STATES_AGAIN = 25


class Shown(Protocol):
    """Publishes cycles for the program."""

    @abstractmethod
    def show(self, seen: CycleRecord) -> Collection[int]:
        """Publish the states of a cycle, then the time; returns their stamps on the bench clock, ns."""

    @abstractmethod
    def show_time(self) -> None:
        """Publish the latest time again."""


class Exchange:
    """Exchange of cycles and commands with one program, for one bench.

    Args:
        topic: topic of its commands.
        shown: publisher of the cycles.
        config: `[ros2]` of the bench file.
        clock: clock of the host.
        wall_ns: ROS time at the bench clock's zero.
        patient: True to wait for the first command without a timeout.

    Attributes:
        cycles, answered: numbers of cycles published since the bench was opened, and of those with a
            command in time.
    """

    def __init__(
        self,
        topic: CommandTopic,
        shown: Shown,
        config: Ros2Config,
        clock: Clock,
        wall_ns: int,
        *,
        patient: bool,
    ) -> None:
        self._topic, self._shown, self._config, self._clock = topic, shown, config, clock
        self._wall_ns, self._patient = wall_ns, patient
        self.cycles = self.answered = 0
        self.begin()

    def begin(self) -> None:
        """Begin a run: its first command is not here yet."""
        self._began_ns: int | None = None
        self._received = False
        self._received_ns = 0

    def in_real_time(self, seen: CycleRecord, until_ns: int) -> ExternalCommands:
        """Publish a cycle and wait for an answer; returns all commands since the last call.

        Args:
            seen: the cycle.
            until_ns: end of the wait for an answer, bench clock.
        """
        messages = self._topic.take()
        self._shown.show(seen)
        answers: list[tuple[str, bytes]] = []
        left_ns = until_ns - self._clock.now_ns()
        if left_ns > 0 and self._topic.publishers():
            self._topic.wait(left_ns)
            answers = self._topic.take()
        self.cycles += 1
        self.answered += bool(answers)
        now_ns = self._clock.now_ns()
        came = [*messages, *answers]
        stop = self._stop_of_publishers() or self._stop_of_silence(now_ns, received=bool(came))
        if stop is not None:
            return stop
        if came:
            self._received_ns = now_ns
        elif self._received and seen.inputs.t_ns - self._received_ns > nanoseconds(self._config.late_after_s):
            return ExternalCommands((), trouble=self._topic.publishers_text())
        return self._passed_on(came, now_ns)

    def in_lockstep(self, seen: CycleRecord) -> ExternalCommands:
        """Publish a cycle, and wait for the one command that belongs to it."""
        self._topic.take()
        stamps, t_ns = self._shown.show(seen), seen.inputs.t_ns
        latest_ns = max(stamps, default=t_ns)
        config, began_ns = self._config, self._clock.now_ns()
        limit_s = config.answer_timeout_s if self._received else config.start_timeout_s
        others, turns = 0, 0
        self.cycles += 1
        while True:
            self._topic.wait(_AGAIN_NS)
            found = self._passed_on(self._topic.take(), t_ns)
            if stop := self._stop_of_publishers():
                return stop
            if found.reason:
                return found
            for command in found.commands:
                copied = command.stamp_ns in stamps and command.stamp_ns != t_ns
                if copied or command.stamp_ns is None or t_ns <= command.stamp_ns <= latest_ns:
                    self._received = True
                    self.answered += 1
                    return ExternalCommands((command,), only_synchronised=not copied)
                others += 1
            if self._clock.now_ns() - began_ns > nanoseconds(limit_s):
                return ExternalCommands((), LOCKSTEP, self._unanswered(seen.cycle, limit_s, others))
            turns += 1
            if not self._received and turns % _STATES_AGAIN == 0:
                self._shown.show(seen)  # messages before the end of discovery are lost
            else:
                self._shown.show_time()

    def _passed_on(self, messages: list[tuple[str, bytes]], t_ns: int) -> ExternalCommands:
        try:
            return ExternalCommands(tuple(commands_of(messages, t_ns, self._wall_ns)))
        except ValueError as error:
            return ExternalCommands(
                (), "ros2_command", f"{self._topic.where} sent what cannot be read ({error})"
            )

    def _stop_of_publishers(self) -> ExternalCommands | None:
        if len(self._topic.publishers()) < 2:
            return None
        return ExternalCommands((), PUBLISHERS, self._topic.several_message())

    def _stop_of_silence(self, now_ns: int, *, received: bool) -> ExternalCommands | None:
        """Stop in real time if the first command does not come; later the controller checks the age."""
        self._received = self._received or received
        if self._began_ns is None:
            self._began_ns = now_ns
        limit_s = self._config.start_timeout_s
        if self._received or self._patient or now_ns - self._began_ns <= nanoseconds(limit_s):
            return None
        return ExternalCommands((), NO_COMMAND, f"no command within {limit_s:g} s: {self._why()}")

    def _unanswered(self, cycle: int, limit_s: float, others: int) -> str:
        why = self._why()
        if others:
            why = (
                f"{others} commands came with stamps of other cycles; copy the stamp of /joint_states, or "
                "set use_sim_time, so that the stamp is /clock's"
            )
        return f"cycle {cycle}: its command did not come within {limit_s:g} s: {why}"

    def _why(self) -> str:
        if not self._topic.publishers():
            return self._topic.none_message()
        return self._topic.silent_message()
