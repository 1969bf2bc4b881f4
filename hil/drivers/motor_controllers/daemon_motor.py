"""Common base of the drivers of motors on CAN that a daemon commands: opening, closing, silence.

These drivers send no commands: a daemon does, which goes on when this program ends. They send it new
set-points, and read reports from the bus, whichever program commands.
"""

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Generic, TypeVar

import can

from hil.config.can_motor import DaemonMotorConfig
from hil.core.clock import NS_PER_S, Clock
from hil.core.errors import DeviceTimeoutError, UsageError
from hil.core.interfaces import Holding
from hil.fan_daemon.commander import MakeCommander, MotorCommander
from hil.fan_daemon.fallback_client import FailoverClient
from hil.fan_daemon.fan_control import SetPoint
from hil.fan_daemon.spec import Spec
from hil.links.can_bus import CanLink, remedy_of_silence
from hil.streams.silence_limit import used_while_closed

C = TypeVar("C", bound=DaemonMotorConfig)
S = TypeVar("S", covariant=True)


class DaemonMotor(Holding[S], Generic[C, S]):
    """A device with one motor or several.

    Args:
        config: bus, ids, ratings.
        clock: the bench clock.
        make_commander: function that makes the motor commander from (spec, clock); the daemon's client when
            None.

    Attributes:
        noun: name of the device in messages, such as `the fan`.
    """

    noun: str

    def __init__(self, config: C, clock: Clock, make_commander: MakeCommander | None = None) -> None:
        self._config, self._clock, self._make_commander = config, clock, make_commander or FailoverClient
        self._link = CanLink(self.name, config, clock, self._is_own)
        self._commander: MotorCommander | None = None
        self._identity: dict[str, str] = {}
        self._forget()

    def _forget(self) -> None:
        """Reset the state that is kept of earlier reports."""
        self._sequence = 0
        self._latest_ns = -1

    def open(self) -> None:
        """Find the controller, read its settings, and find or start the daemon that commands it.

        No command is sent; a motor that runs goes on as it runs.

        Raises:
            ConfigError: an unusable timeout.
            DeviceError: the controller is missing, shares its id, reports nothing, or may release the robot.
        """
        self.close()
        spec = Spec(**self._config.daemon_spec())
        self._link.open()
        try:
            identity = self._greet(spec)
            self._commander = self._make_commander(spec, self._clock)
            self._commander.open()
            self._forget()
            self._link.set_decoder(self._meaning)
        except BaseException:
            self.close()
            raise
        self._identity = identity

    @abstractmethod
    def _greet(self, spec: Spec) -> dict[str, str]:
        """Find the controller on the open bus and check its settings; returns its identity."""

    @abstractmethod
    def _is_own(self, key: int) -> bool:
        """Whether a frame, by its `frame_key`, is a report of the motor's controller."""

    @abstractmethod
    def _meaning(self, t_ns: int, message: can.Message, now_ns: int) -> S | None:
        """The sample that a frame completes, or None; frames include commands of daemons."""

    def close(self) -> None:
        """Close the bus; motors that run go on. Idempotent; never raises."""
        self._identity = {}
        commander, self._commander = self._commander, None
        if commander is not None:
            commander.close()
        self._link.close()

    def identity(self) -> Mapping[str, str]:
        """Model, bus, controllers and firmware; empty while closed."""
        return self._identity

    def _must_be_open(self) -> MotorCommander:
        if self._commander is None:
            raise used_while_closed(self.name, self._link.port)
        return self._commander

    def _duty(self, duty: float) -> SetPoint:
        """The set-point of a duty; raises `UsageError` for one that is not above 0 and at most 1."""
        if not (math.isfinite(duty) and 0.0 < duty <= 1.0):
            raise UsageError(
                f"{self.name}: a duty of {duty:g}",
                expected="above 0, at most 1",
                remedy=f"`hil adhesion off` lets {self.noun} come to rest",
            )
        return SetPoint("duty", duty)

    def _silence(self, whose: str, silent_ns: int, then: str) -> DeviceTimeoutError:
        """The error for `silent_ns` without a report of `whose`; `then`: what it does without commands."""
        return DeviceTimeoutError(
            self.name,
            f"no report of {whose} for {silent_ns / NS_PER_S:.1f} s{self._link.bus_errors()}: once no "
            f"command reaches it for {self._config.timeout_s:g} s {then}. Secure the robot",
            port=self._link.port,
            expected="status message 1",
            remedy="plug the CAN adapter in again; "
            + remedy_of_silence(self.name, self._config, "the controller"),
        )
