"""The start-up parameters of a daemon: which motor, on which bus, how often, how fast it may ramp."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from hil.core.errors import ConfigError
from hil.support.emulated_can_mark import bus_name

_HIGHEST = {"duty": 0.95, "current_a": 60.0, "erpm": 150_000.0}
_PERIODS = 10
"""Least number of commands within the controller's timeout."""
_LONGEST_PERIOD_S = 0.1
_WHOSE = {"adhesion": "the fan's", "thrust": "the propellers'"}


@dataclass(frozen=True)
class Spec:
    """One fan, or propellers that get the same command, and how they are commanded.

    Attributes:
        interface, channel, bitrate, options: bus in the terms of python-can; two programs must be able to
            share the channel.
        controller_id: id of the motor controller.
        also: ids of further controllers that are given every command of the first.
        device: name of the device in messages.
        protocol: protocol of the controller: `vesc` or `dronecan`.
        details: further figures that the protocol needs.
        period_s: time between two commands.
        timeout_s: time without a command after which the controller releases the motor, as set in it.
        ramp_up_s, ramp_down_s: time from rest to the highest set-point, and back.
        highest: the highest set-point for each quantity.
    """

    interface: str
    channel: str
    controller_id: int
    also: tuple[int, ...] = ()
    device: str = "adhesion"
    bitrate: int = 500_000
    options: Mapping[str, Any] = field(default_factory=dict)
    protocol: str = "vesc"
    details: Mapping[str, float] = field(default_factory=dict)
    period_s: float = 0.05
    timeout_s: float = 1.0
    ramp_up_s: float = 2.0
    ramp_down_s: float = 4.0
    highest: Mapping[str, float] = field(default_factory=lambda: dict(_HIGHEST))

    def __post_init__(self) -> None:
        figures = (self.period_s, self.timeout_s, self.ramp_up_s, self.ramp_down_s, *self.highest.values())
        if not all(math.isfinite(f) for f in figures) or min(*self.highest.values(), self.ramp_up_s) <= 0.0:
            raise ConfigError(
                f"{self.name}: ramps and highest set-points",
                expected="finite, above 0",
                remedy=f"correct ramp_up_s, ramp_down_s and the ratings of [{self.device}]",
            )
        if not 0.0 < self.period_s <= _LONGEST_PERIOD_S:
            raise ConfigError(
                f"{self.name}: period_s = {self.period_s:g}",
                expected=f"above 0, at most {_LONGEST_PERIOD_S}",
                remedy="leave it out: it is 0.05 then",
            )
        if self.timeout_s == 0.0:
            raise ConfigError(
                f"{self.name}: {self.device}.timeout_s = 0: without a timeout {self.noun} would run for "
                "ever once no program commands it",
                expected="the controller's timeout in s",
                remedy="set it in VESC Tool (App Settings, General, Timeout), 1000 ms is usual",
            )
        if self.timeout_s < _PERIODS * self.period_s:
            raise ConfigError(
                f"{self.name}: {self.device}.timeout_s = {self.timeout_s:g}: a timeout too short for "
                f"commands every {self.period_s:g} s: one late command would let go of the robot",
                expected=f"at least {_PERIODS * self.period_s:g} s",
                remedy="raise it in VESC Tool (App Settings, General, Timeout), 1000 ms is usual",
            )
        if self.ramp_down_s < 1.0:
            raise ConfigError(
                f"{self.name}: ramp_down_s = {self.ramp_down_s:g}: what stops at once drops the robot",
                expected="at least 1 s",
                remedy=f"raise {self.device}.ramp_down_s",
            )

    @property
    def name(self) -> str:
        """The fan, as messages and the socket call it: no two daemons have the same."""
        return f"{self.bus}, controller {self.controller_id}"

    @property
    def bus(self) -> str:
        """The bus, as messages and the socket call it."""
        return bus_name(self.interface, self.channel, self.options)

    @property
    def noun(self) -> str:
        """`the fan`, as messages call it."""
        return self.whose.removesuffix("'s").removesuffix("'")

    @property
    def whose(self) -> str:
        """`the fan's`, as messages about its daemon begin."""
        return _WHOSE.get(self.device, f"{self.device}'s")

    def to_json(self) -> str:
        """The specification as JSON, for the command line of the process."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Spec:
        """Parse `to_json`; raises `ConfigError`."""
        try:
            given = json.loads(text)
            return cls(**{**given, "also": tuple(given.get("also", ()))})
        except (ValueError, TypeError, AttributeError) as error:
            if isinstance(error, ConfigError):
                raise
            raise ConfigError(
                f"the daemon's start ({error})",
                expected="what Spec.to_json writes",
                remedy="start it by `hil adhesion keep`",
            ) from None
