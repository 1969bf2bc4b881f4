"""Sums the difference of two devices beyond their tolerances, and describes the disagreement.

Deterministic: depends only on the steps that were added since `reset`.
"""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hil.core.clock import NS_PER_S
from hil.loop.checks.wrong_parameter import Explanation, explained, explained_by_delay, explained_by_lever

STEP_NS = 58_000_000
"""Shortest interval between two comparisons."""
_LITTLE = 0.3
_TURNS_RAD_M = 1.0
"""Turn per metre from which the place of a sensor on the body moves it, more than its scale or mount."""
_FROM_THE_START = 0.7
"""Share of all steps of a run that a wrong parameter has changed: all but the first."""
_CLEARLY, _MOST_STEPS = 2.0, 600
"""Factor by which a cause has to leave less unexplained than another; and number of steps that are kept."""
_JUMP_M, _JUMP_RAD, _CALM_NS = 0.02, 0.05, 500_000_000


class MotionSource(NamedTuple):
    """A device that measures motion: the name of its kind, and its name in messages."""

    name: str
    called: str


CAMERA, WHEELS = MotionSource("tracker", "the camera"), MotionSource("servos", "the wheels")


@dataclass(frozen=True)
class Disagreement:
    """A disagreement of two devices about motion.

    Attributes:
        source: the device that the others contradict, or the first of two.
        message: text with both measurements.
        grave: True if the robot must stop.
        confirmed: True if two other devices agree against the source.
        off: difference of the two since it began, m or rad.
        turns: True if the difference is a turn.
        against: the device that contradicts the source.
        unseen: True if the wheels may have slipped before the camera delivered poses.
        key: keys of the bench file that would explain it, separated by commas; empty for none.
        factor: factor by which the value of a single key would fit; 0 for none.
    """

    source: str
    message: str
    grave: bool
    confirmed: bool = False
    off: float = 0.0
    turns: bool = False
    against: str = ""
    unseen: bool = False
    key: str = ""
    factor: float = 0.0

    @property
    def inflation(self) -> tuple[float, float]:
        """Largest error of the estimate (m, rad): the difference of the two devices."""
        return (0.0, self.off) if self.turns else (self.off, 0.0)

    @property
    def may_slide(self) -> bool:
        """Whether the wheels may miss a motion because the robot slides."""
        return self.source == WHEELS.name or (self.against == WHEELS.name and not self.confirmed)


class Sum:
    """Accumulated difference of two devices, in the plane of the body (m), or in heading (rad).

    Args:
        first, second: the devices.
        warn, stop: sums at which a warning is given, and the robot stopped.
        turns: True if the sum is one of turns.

    Attributes:
        names: names of the devices.
        size: accumulated difference beyond the tolerance.
        since_ns: time when the difference began.
    """

    def __init__(
        self, first: MotionSource, second: MotionSource, warn: float, stop: float, *, turns: bool = False
    ) -> None:
        self._parties, self.names = (first, second), (first.name, second.name)
        self._warn_at, self._stop_at, self._turns = warn, stop, turns
        self.reset()

    def reset(self) -> None:
        """Reset the sum to zero, for a new run."""
        self._way = 0.0
        self._begin()

    def _begin(self) -> None:
        """Begin anew with the next step."""
        self.size = 0.0
        self._sum = self._first = self._second = 0j
        self._rotated_rad = 0.0
        self._gone: list[tuple[float, float]] = []
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
        """Add the difference of one step, minus the tolerance.

        Args:
            t_ns: beginning of the step.
            first: step by the first device.
            second: step by the second device.
            allowed: tolerance of good sensors.
            turned: unit complex number that rotates the axes at the beginning to those at the end.
            backwards: additional tolerance for a shorter step of the first device along the first axis.
            way: additional tolerance as shares of the second device's step, along it and across.
        """
        self._way += max(abs(first), abs(second))
        if self.size == 0.0:
            self._begin()
            self.since_ns = t_ns
        self._rotated_rad += abs(cmath.phase(turned))
        self._first, self._second = (self._first + first) * turned, (self._second + second) * turned
        if len(self._gone) < _MOST_STEPS:
            self._gone.append((abs(self._second), abs(self._first) - abs(self._second)))
        total = self._sum + first - second
        if total.real < 0.0:
            total += min(backwards, -total.real)
        total = _shrunk(total, second, way)
        size = abs(total)
        self.size = max(0.0, size - allowed)
        self._sum = total * turned * (self.size / size) if size else 0j

    def news(self) -> bool:
        """Whether to report now: once above the warning limit, and always above the stop limit."""
        return self.size > self._warn_at and (not self._warned or self.size > self._stop_at)

    @property
    def suspicious(self) -> bool:
        """Whether the devices differ by more than half of the warning limit."""
        return 2.0 * self.size > self._warn_at

    def doubt(self, t_ns: int, pairs: Sequence[Sum], borne_out: str = "") -> Disagreement:
        """The disagreement to report; grave only after a first report.

        Args:
            t_ns: present time.
            pairs: all sums of the same kind.
            borne_out: device that agrees with one that is in none of them: the others do not outvote it.
        """
        grave, self._warned = self._warned, True
        source = alone(self, pairs)
        moved, unit = ("turned", "mrad") if self._turns else ("moved", "mm")
        one, other = (party.called for party in self._parties)
        defended = source == borne_out
        if defended:
            source = self.names[1 - self.names.index(source)]
        sure = not defended and confirmed(self, pairs, source)
        called, against = (one, self.names[1]) if source == self.names[0] else (other, self.names[0])
        blamed = [(self, name) for name in ([source] if sure else [source, against])]
        why = f"the others agree against {called}" if sure else self._why()
        if defended:
            why = f"another sensor agrees with {other if called == one else one}"
            blamed = [(pair, name) for pair in pairs if against in pair.names for name in pair.names]
        causes = [found for pair, name in blamed if name != borne_out and (found := pair._cause(name))]
        look = "; ".join(f"{found.key}, {found.text}" for found in causes)
        if sure and source == "servos" and not causes:
            look = "single wheels (`hil run bring_up`): no factor and no angle of all wheels explains this"
        return Disagreement(
            source,
            f"in {(t_ns - self.since_ns) / NS_PER_S:.1f} s the robot {moved} "
            f"{1e3 * abs(self._first):.0f} {unit} by {one} and {1e3 * abs(self._second):.0f} {unit} by "
            f"{other}: {why}" + (f"; look at {look}" if look else ""),
            grave,
            sure,
            abs(self._first - self._second),
            self._turns,
            against,
            key=", ".join(found.key for found in causes),
            factor=causes[0].factor if len(causes) == 1 else 0.0,
        )

    def _cause(self, name: str) -> Explanation | None:
        """The parameter of one of the two that would explain all steps of this run; None for none."""
        own, other = (self._first, self._second) if name == self.names[0] else (self._second, self._first)
        if max(abs(own), abs(other)) < _FROM_THE_START * self._way or not abs(other) > 0.0:
            return None
        if not self._turns and self._rotated_rad > _TURNS_RAD_M * abs(other):
            return explained_by_lever(name, abs(own - other) / self._rotated_rad)
        found = explained(name, own / other, turns=self._turns)
        if found is not None and found.factor and not self._is_scaled():
            return explained_by_delay(name) if self._is_delayed() else None
        return found

    def _is_scaled(self) -> bool:
        """Whether the difference grows with the way, clearly rather than with the speed."""
        of_way, of_speed = self._unexplained()
        return _CLEARLY * of_way <= of_speed

    def _is_delayed(self) -> bool:
        """Whether the difference grows with the speed, clearly rather than with the way."""
        of_way, of_speed = self._unexplained()
        return _CLEARLY * of_speed <= of_way

    def _unexplained(self) -> tuple[float, float]:
        """Squares that are left of the difference after one factor of the way, and after one of the speed.

        A sensor with a wrong scale differs by a share of the way, a late one by the way of its delay.
        """
        way, off = np.array(self._gone).T
        steps = np.diff(way, prepend=0.0)
        of_way, of_speed = (off @ off - (off @ one) ** 2 / max(one @ one, 1e-12) for one in (way, steps))
        return float(of_way), float(of_speed)

    def _why(self) -> str:
        if self.names != (CAMERA.name, WHEELS.name):
            return "one of them is wrong" + (", or the wheels slip" if "servos" in self.names else "")
        if abs(self._second) < _LITTLE * abs(self._first):
            return "the robot slides, or the camera reports false motion"
        if abs(self._first) < abs(self._second):
            return "the camera is frozen or sees another scale, or the wheels slip"
        return "the camera sees another scale, or the robot slides"


def _shrunk(total: complex, step: complex, way: tuple[float, float]) -> complex:
    """Reduce a sum by the shares (along, across) of a step, but not beyond zero."""
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
    """Distinguishes a jump of a corrected pose (relocalisation) from motion."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Clear the last jump."""
        self._calm_ns = 0

    def jumped(self, t_ns: int, way_m: float, turn_rad: float) -> bool:
        """Whether a step is a relocalisation; a second one within a short time counts as motion."""
        if way_m < _JUMP_M and turn_rad < _JUMP_RAD:
            return False
        calm, self._calm_ns = t_ns >= self._calm_ns, t_ns + _CALM_NS
        return calm


def alone(pair: Sum, pairs: Sequence[Sum]) -> str:
    """The device of a pair that others contradict more; the first if undecided.

    Args:
        pair: sum of two devices.
        pairs: sums of the same kind, of these two and others.
    """
    others = [other for other in pairs if other is not pair]
    return max(pair.names, key=lambda name: sum(o.size for o in others if name in o.names))


def confirmed(pair: Sum, pairs: Sequence[Sum], source: str) -> bool:
    """Whether a third device also contradicts the source of a pair, and agrees with the other device."""
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
