"""Moves the robot by hand, while a key is held: the whole body, one wheel, or one steering axis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from hil.core.external_commands import ExternalCommand, ExternalCommands
from hil.core.interfaces import CommandingSink
from hil.core.known_names import JOG
from hil.core.signals import CycleRecord
from hil.live.held_keys import Keys
from hil.live.velocity_input import CommandLines

if TYPE_CHECKING:
    from hil.bench import Bench
    from hil.bench.bench import Until
    from hil.recording.runs import RunStart

_BODY = {"w": (1, 0, 0), "s": (-1, 0, 0), "a": (0, 1, 0), "d": (0, -1, 0), "q": (0, 0, 1), "e": (0, 0, -1)}
_JOINT = {"w": 1.0, "s": -1.0, "a": 1.0, "d": -1.0}
_NONE = np.zeros(0)


class BodyKeys(CommandLines):
    """Velocity commands of the held key; at rest without one.

    Args:
        keys: source of the keys.
        speed_m_s, turn_rad_s: speed ahead and to the left, and rate of turning.
    """

    where = "the operator"

    def __init__(self, keys: Keys, speed_m_s: float, turn_rad_s: float) -> None:
        self._keys, self._speed_m_s, self._turn_rad_s = keys, speed_m_s, turn_rad_s

    def pending(self) -> list[str]:
        """One command for this cycle."""
        ahead, left, turn = _BODY.get(self._keys.held(), (0, 0, 0))
        return [f"v {ahead * self._speed_m_s!r} {left * self._speed_m_s!r} {turn * self._turn_rad_s!r}"]

    def counts(self) -> Mapping[str, int]:
        """How often a key was held for too long."""
        return {"stuck_keys": self._keys.stuck}

    def close(self) -> None:
        """Do nothing: the terminal stays open."""


class JointJog(CommandingSink):
    """Commands of one joint by the held key, in place of a program that drives the bench.

    Args:
        joint: name of the servo.
        keys: source of the keys.
        rate_rad_s: rate of the joint while a key is held.
    """

    def __init__(self, joint: str, keys: Keys, rate_rad_s: float) -> None:
        self.name = JOG + joint
        self._joint, self._keys, self._rate_rad_s, self._moved = joint, keys, rate_rad_s, 0

    def ask(self, seen: CycleRecord) -> ExternalCommands:
        """The command of this cycle; none where no key is held."""
        way = _JOINT.get(self._keys.held(), 0.0)
        if not way:
            return ExternalCommands()
        self._moved += 1
        rate = np.array([way * self._rate_rad_s])
        return ExternalCommands(
            (ExternalCommand(seen.inputs.t_ns, None, "joints", (self._joint,), _NONE, rate, _NONE),)
        )

    def found(self) -> bool:
        """Whether the operator is there: always."""
        return True

    def sends_joints(self) -> bool:
        """Whether joints are commanded: always."""
        return True

    def velocities(self) -> CommandLines:
        """Velocities of the body: always at rest."""
        return BodyKeys(self._keys, 0.0, 0.0)

    def counts(self) -> Mapping[str, int]:
        """Numbers of cycles with a held key, and of keys that were held for too long."""
        return {"cycles_moved": self._moved, "stuck_keys": self._keys.stuck}

    def look(self, t_ns: int) -> None:
        """Do nothing: `LivePlan.over` ends the session."""

    def wait(self, bench: Bench, start: RunStart, over: Until) -> None:
        """Do nothing: the operator is there."""

    def write(self, record: CycleRecord) -> None:
        """Do nothing: `ask` has seen the cycle."""

    def close(self) -> None:
        """Do nothing: the terminal stays open."""
