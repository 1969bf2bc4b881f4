"""Sums the difference of two devices beyond their tolerances, and describes the disagreement.

Deterministic: depends on the steps that were added since `reset` and on nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hil.core.clock import NS_PER_S

STEP_NS = 58_000_000
"""What two devices say is compared no more often."""
_LITTLE = 0.3
_JUMP_M, _JUMP_RAD, _CALM_NS = 0.02, 0.05, 500_000_000


class MotionSource(NamedTuple):
    """A device that measures motion: the name of its kind, and what messages call it."""

    name: str
    called: str


CAMERA, WHEELS = MotionSource("tracker", "the camera"), MotionSource("servos", "the wheels")


@dataclass(frozen=True)
class Disagreement:
    """Two devices disagree.

    Attributes:
        source: the device that is alone with what it says, or the first of two.
        message: what each says.
        grave: whether the robot must not go on by them.
        confirmed: whether two others agree against the source.
        off: by how much the two differ since they began to, m or rad.
        turns: whether that is a turn.
        against: the device that says otherwise.
        unseen: whether the wheels may have slipped while the camera did not look yet.
    """

    source: str
    message: str
    grave: bool
    confirmed: bool = False
    off: float = 0.0
    turns: bool = False
    against: str = ""
    unseen: bool = False

    @property
    def inflation(self) -> tuple[float, float]:
        """By how much the estimate may be off (m, rad): the difference of the two."""
        return (0.0, self.off) if self.turns else (self.off, 0.0)

    @property
    def may_slide(self) -> bool:
        """Whether it may be the wheels that say nothing of a motion, because the robot slides."""
        return self.source == WHEELS.name or (self.against == WHEELS.name and not self.confirmed)


class Sum:
    """Accumulated difference of two devices, in the plane of the body (m), or in heading (rad).

    Args:
        first, second: the devices.
        warn, stop: sums at which a warning is given, and the robot stopped.
        turns: whether it is of turns.

    Attributes:
        names: of the devices.
        size: by how much more than honest ones they differ.
        since_ns: when they began to.
    """

    def __init__(
        self, first: MotionSource, second: MotionSource, warn: float, stop: float, *, turns: bool = False
    ) -> None:
        self._parties, self.names = (first, second), (first.name, second.name)
        self._warn_at, self._stop_at, self._turns = warn, stop, turns
        self.reset()

    def reset(self) -> None:
        """Begin the sum again at zero."""
        self.size = 0.0
        self._sum = self._first = self._second = 0j
        self.since_ns = 0
        self._warned = False

    def add(
        self,
        t_ns: int,
        first: complex,
        second: complex,
        allowed: float,
        turned: complex = 1.0,
        backwards: float = 0.0,
        way: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Take a step of both from `t_ns` on, less what they may differ by in it.

        Args:
            t_ns: its beginning.
            first: what one device says.
            second: what the other says.
            allowed: what honest ones may differ by.
            turned: unit number that takes axes at its beginning to those at its end.
            backwards: by how much more the first may have gone less far along the first axis.
            way: by which share of the second's step they may differ beside that, along it and across.
        """
        if self.size == 0.0:
            self.reset()
            self.since_ns = t_ns
        self._first, self._second = (self._first + first) * turned, (self._second + second) * turned
        total = self._sum + first - second
        if total.real < 0.0:
            total += min(backwards, -total.real)
        total = _shrunk(total, second, way)
        size = abs(total)
        self.size = max(0.0, size - allowed)
        self._sum = total * turned * (self.size / size) if size else 0j

    def news(self) -> bool:
        """Whether something is to be said now: once when it becomes known, and always when it is grave."""
        return self.size > self._warn_at and (not self._warned or self.size > self._stop_at)

    @property
    def suspicious(self) -> bool:
        """Whether they differ by more than half of the limit for a warning."""
        return 2.0 * self.size > self._warn_at

    def doubt(self, t_ns: int, pairs: Sequence[Sum]) -> Disagreement:
        """The disagreement to report; grave only after a first report.

        Args:
            t_ns: now.
            pairs: all sums of the same kind.
        """
        grave, self._warned = self._warned, True
        source = alone(self, pairs)
        moved, unit = ("turned", "mrad") if self._turns else ("moved", "mm")
        one, other = (party.called for party in self._parties)
        sure = confirmed(self, pairs, source)
        called, against = (one, self.names[1]) if source == self.names[0] else (other, self.names[0])
        return Disagreement(
            source,
            f"in {(t_ns - self.since_ns) / NS_PER_S:.1f} s the robot {moved} "
            f"{1e3 * abs(self._first):.0f} {unit} by {one} and {1e3 * abs(self._second):.0f} {unit} by "
            f"{other}: " + (f"the others agree against {called}" if sure else self._why()),
            grave,
            sure,
            abs(self._first - self._second),
            self._turns,
            against,
        )

    def _why(self) -> str:
        if self.names != (CAMERA.name, WHEELS.name):
            return "one of them is wrong" + (", or the wheels slip" if "servos" in self.names else "")
        if abs(self._second) < _LITTLE * abs(self._first):
            return "the robot slides, or the camera invents motion"
        if abs(self._first) < abs(self._second):
            return "the camera is frozen or sees another scale, or the wheels slip"
        return "the camera sees another scale, or the robot slides"


def _shrunk(total: complex, step: complex, way: tuple[float, float]) -> complex:
    """A sum less the shares (along, across) of a step, never beyond zero."""
    length = abs(step)
    if not length or way == (0.0, 0.0):
        return total
    axis = step / length
    own = total * axis.conjugate()
    parts = [
        max(0.0, abs(part) - share * length) * (1.0 if part >= 0.0 else -1.0)
        for part, share in zip((own.real, own.imag), way, strict=True)
    ]
    return complex(*parts) * axis


class Relocalisation:
    """Tells the leap of a pose that was put right from motion."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the last leap."""
        self._calm_ns = 0

    def jumped(self, t_ns: int, way_m: float, turn_rad: float) -> bool:
        """Whether a step is a relocalisation; one that follows another too soon is motion and counts."""
        if way_m < _JUMP_M and turn_rad < _JUMP_RAD:
            return False
        calm, self._calm_ns = t_ns >= self._calm_ns, t_ns + _CALM_NS
        return calm


def alone(pair: Sum, pairs: Sequence[Sum]) -> str:
    """The device of a pair that others contradict more; the first when it is not known.

    Args:
        pair: of two devices.
        pairs: sums of the same kind, of these two and others.
    """
    others = [other for other in pairs if other is not pair]
    return max(pair.names, key=lambda name: sum(o.size for o in others if name in o.names))


def confirmed(pair: Sum, pairs: Sequence[Sum], source: str) -> bool:
    """Whether a third device contradicts the source of a pair, too, and agrees with the other one."""
    (other,) = (name for name in pair.names if name != source)
    by_names = {frozenset(p.names): p for p in pairs}
    thirds = {name for p in pairs for name in p.names} - set(pair.names)
    return any(
        (against := by_names.get(frozenset((source, third)))) is not None
        and (beside := by_names.get(frozenset((other, third)))) is not None
        and against.suspicious
        and not beside.suspicious
        for third in thirds
    )
