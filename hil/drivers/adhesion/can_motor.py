"""Motors on CAN that a keeper runs: how their driver opens, lets go, and says that nothing answers.

Commands are not sent from here. A keeper sends them, which goes on when this program ends; it is told of
another set-point only. Reports are read from the bus, whoever commands.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Generic, TypeVar

import can

from hil.config.can_motor import KeptMotorConfig
from hil.core.clock import NS_PER_S, Clock
from hil.core.errors import DeviceTimeoutError, UsageError
from hil.core.interfaces import Holding
from hil.drivers.adhesion.keeper.core import SetPoint
from hil.drivers.adhesion.keeper.deputy import KeptByProcess
from hil.drivers.adhesion.keeper.kept import Keep, Kept
from hil.drivers.adhesion.keeper.spec import Spec
from hil.drivers.links.can_bus import CanLink, remedy_of_silence
from hil.drivers.links.silence_limit import used_while_closed

C = TypeVar("C", bound=KeptMotorConfig)
S = TypeVar("S", covariant=True)


class KeptMotor(Holding[S], Generic[C, S]):
    """One device of one motor or several.

    Args:
        config: bus, ids, ratings.
        clock: the bench clock.
        keep: makes who keeps it running, of (spec, clock).

    Attributes:
        noun: what it is called in messages.
    """

    noun: str

    def __init__(self, config: C, clock: Clock, keep: Keep | None = None) -> None:
        self._config, self._clock, self._keep = config, clock, keep or KeptByProcess
        self._link = CanLink(self.name, config, clock)
        self._kept: Kept | None = None
        self._identity: dict[str, str] = {}
        self._forget()

    def _forget(self) -> None:
        """What was read before it was opened does not count."""
        self._sequence = 0
        self._latest_ns = -1

    def open(self) -> None:
        """Find who is meant, read how it is set, and see to it that something keeps it running.

        Nothing is commanded; what runs goes on as it runs.

        Raises:
            ConfigError: a time-out that cannot be meant.
            DeviceError: it is not there, not alone, tells nothing, or would let go of the robot.
        """
        self.close()
        spec = Spec(**self._config.keeper())
        self._link.open()
        try:
            identity = self._greet(spec)
            self._kept = self._keep(spec, self._clock)
            self._kept.open()
            self._forget()
            self._link.listen_for(self._meaning)
        except BaseException:
            self.close()
            raise
        self._identity = identity

    @abstractmethod
    def _greet(self, spec: Spec) -> dict[str, str]:
        """Find who is meant on the open bus, look whether it may be trusted; its identity."""

    @abstractmethod
    def _meaning(self, t_ns: int, message: can.Message, now_ns: int) -> S | None:
        """The sample that a frame completes; None for none: keepers' commands pass by here, too."""

    def close(self) -> None:
        """Let go of the bus; what runs goes on. Idempotent; never raises."""
        self._identity = {}
        kept, self._kept = self._kept, None
        if kept is not None:
            kept.close()
        self._link.close()

    def identity(self) -> Mapping[str, str]:
        """Model, bus, controllers and firmware; empty while closed."""
        return self._identity

    def _must_be_open(self) -> Kept:
        if self._kept is None:
            raise used_while_closed(self.name, self._link.port)
        return self._kept

    def _duty(self, duty: float) -> SetPoint:
        """A duty as it is; raises `UsageError` for one that cannot be meant."""
        if not (math.isfinite(duty) and 0.0 < duty <= 1.0):
            raise UsageError(
                f"{self.name}: a duty of {duty:g}",
                expected="above 0, at most 1",
                remedy=f"`hil adhesion off` lets {self.noun} come to rest",
            )
        return SetPoint("duty", duty)

    def _silence(self, whose: str, silent_ns: int, then: str) -> DeviceTimeoutError:
        """Nothing was heard of `whose` for so long; `then` is what it does without commands."""
        return DeviceTimeoutError(
            self.name,
            f"no report of {whose} for {silent_ns / NS_PER_S:.1f} s{self._link.told()}: once no command "
            f"reaches it for {self._config.timeout_s:g} s {then}. Secure the robot",
            port=self._link.port,
            expected="status message 1",
            remedy="plug the CAN adapter in again; "
            + remedy_of_silence(self.name, self._config, "the controller"),
        )
