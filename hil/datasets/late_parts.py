"""Finds one or two wheels, or positions against the heading of the ground truth, that come late.

Each wheel's moves over 0.2 s are compared with those of the ground truth at its place, for many delays of
each. Starts and stops show the delays. A delay that all wheels have in common, another in each recording, is
one of the ground truth and is corrected elsewhere. What a wheel, two wheels or the positions add to it is one
number for the whole set: it is named where it explains clearly more than anything else does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt

from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.datasets.nominal_robot import lever_m
from hil.datasets.sampling import interpolate, is_slow
from hil.datasets.truth_moves import known_at
from hil.datasets.wheel_displacements import Complexes, by_truth
from hil.datasets.wheel_log import Recording

_STEP_S, _EVERY, _MOVE = 0.02, 2, 5
"""Step of the delays; its multiple from edge to edge; edges of a move."""
_COARSE, _FAR, _NEAR = 5, 100, 30
"""Steps of the search for the common delay, how far it goes, and how far later parts differ from it."""
_PAIRS = ((0, 1), (0, 2), (0, 3))
_POSITIONS = "positions"
_LATE_S, _GAIN, _CLEARLY, _IN_MOST = 0.03, 100.0, 1.5, 0.8
"""Delay, and logarithm of the likelihood ratio, from which on a cause counts; by how much more than any other
it has to explain; share of the recordings that show it in which it has to explain something."""
_SHOWS, _BOTH = 3.0, 0.1
_BY_ONE = ": stamp all columns by one clock"
_LEAST = 1e-12


@dataclass(frozen=True)
class Misfits:
    """Squared misfits of a recording, m^2, with a scale and an angle of each wheel allowed.

    Attributes:
        wheels: (4 f + 1, 4) of each wheel, for delays of the ground truth about the common one.
        positions: (f + 1, 2 f + 1) of all wheels, for delays of the positions alone, two steps apart, and of
            the heading about the common delay; (1, 2 f + 1) without such delays where they do not matter.
        count: number of moves of all wheels that do not overlap.
    """

    wheels: Array
    positions: Array
    count: float

    @classmethod
    def of(cls, one: Recording) -> "Misfits | None":
        """Those of a recording; None where it is too short, or its ground truth too slow. Cached."""
        if "late_parts" not in one.derived:
            one.derived["late_parts"] = cls._found(one)
        return cast("Misfits | None", one.derived["late_parts"])

    @classmethod
    def _found(cls, one: Recording) -> "Misfits | None":
        if not one.has_truth or one.of_twist or one.contradictions or is_slow(one.truth_t_s):
            return None
        moves = _Moves(one)
        if moves.count < 8 * _MOVE:
            return None
        here = moves.of_truth(0)
        steps = np.arange(-_FAR, _FAR + 1, _COARSE)
        common = int(steps[np.argmin(moves.misfits(here, steps).sum(axis=1))])
        far, near = (common + np.arange(-n, n + 1) for n in (2 * _NEAR, _NEAR))
        late = np.arange(-_NEAR, _NEAR + 1, 2) if _turns_on_its_way(one) else np.zeros(1, dtype=np.int_)
        positions = [moves.misfits(moves.of_truth(k), near).sum(axis=1) for k in late.tolist()]
        return cls(moves.misfits(here, far), np.array(positions), len(WHEELS) * moves.count / _MOVE)

    def gains(self) -> dict[str, Array]:
        """Logarithm of the likelihood ratio of each cause, for its delays, against a common delay alone."""
        none = self.wheels[_NEAR : 3 * _NEAR + 1]
        least = max(float(none.sum(axis=1).min()), _LEAST)
        n, late = len(none), np.arange(-_NEAR, _NEAR + 1)
        found = dict[str, Array]()
        for alone in (*((i,) for i in range(len(WHEELS))), *_PAIRS):
            others = [i for i in range(len(WHEELS)) if i not in alone]
            rest, own = none[:, others].sum(axis=1), self.wheels[:, list(alone)].sum(axis=1)
            left = [float((rest + own[_NEAR - k : _NEAR - k + n]).min()) for k in late]
            found[" ".join(WHEELS[i] for i in alone)] = np.array(left)
        each = np.broadcast_to(self.positions.min(axis=1), len(late[::2]))
        found[_POSITIONS] = np.interp(late, late[::2], each)
        return {
            cause: 0.5 * self.count * np.log(least / np.maximum(left, _LEAST))
            for cause, left in found.items()
        }


def with_late_parts(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` of all name wheels, or positions, that are late in the whole set."""
    found = {
        k: misfits.gains() for k, one in enumerate(recordings) if (misfits := Misfits.of(one)) is not None
    }
    if not (said := _late(list(found.values()))):
        return list(recordings)
    return [one.contradicted(said) if k in found else one for k, one in enumerate(recordings)]


def _late(found: Sequence[Mapping[str, Array]]) -> str:
    """What is late in a set, and by how much; empty where no cause explains clearly more than others."""
    if not found:
        return ""
    sums = {cause: np.sum([one[cause] for one in found], axis=0) for cause in found[0]}
    first, second = sorted(sums, key=lambda cause: float(sums[cause].max()), reverse=True)[:2]
    best = int(np.argmax(sums[first]))
    late_s, gain = _STEP_S * (best - _NEAR), float(sums[first].max())
    each = np.array([one[first][best] for one in found])
    shows = each[np.abs(each) > _SHOWS]
    if abs(late_s) < _LATE_S or gain < max(_GAIN, _CLEARLY * float(sums[second].max())):
        return ""
    if np.mean(shows > 0.0) < _IN_MOST:
        return ""
    word, by = ("later", "earlier")[:: 1 if late_s > 0.0 else -1], f"{abs(late_s):.2f} s"
    if first == _POSITIONS:
        return (
            f"the positions (x, y, or both) of its ground truth come {by} {word[0]} than its heading{_BY_ONE}"
        )
    wheels = first.split()
    others = [wheel for wheel in WHEELS if wheel not in wheels]
    if len(wheels) == 1:
        i = WHEELS.index(wheels[0]) + 1
        return (
            f"its {wheels[0]} wheel (phi{i}, and delta{i} where it steers) comes {by} {word[0]} than the "
            f"other three{_BY_ONE}"
        )
    return (
        f"its {' and '.join(wheels)} wheels come {by} {word[0]} than the {' and '.join(others)} wheels: "
        f"either pair may be the one whose stamps are wrong{_BY_ONE}"
    )


def _turns_on_its_way(one: Recording) -> bool:
    """Whether the body goes and turns, as on a circle: only there it matters that one is late."""
    turn_m = lever_m(one.nominal.geometry) * float(np.ptp(one.truth_pose[:, 2]))
    way_m = max(float(np.ptp(one.truth_pose[:, j])) for j in (0, 1))
    return min(turn_m, way_m) > _BOTH * max(turn_m, way_m)


class _Moves:
    """Moves of a recording between edges, on a grid of the delays."""

    def __init__(self, one: Recording) -> None:
        self._one, wheels = one, one.nominal.geometry
        begin_s, end_s = max(one.t_s[0], one.truth_t_s[0]), min(one.t_s[-1], one.truth_t_s[-1])
        self._edges_s: Array = np.arange(begin_s, end_s, _STEP_S * _EVERY)
        self.count = len(self._edges_s) - _MOVE
        heading = 0.5 * (one.steering_rad[1:] + one.steering_rad[:-1]) - wheels.steering_zero_rad
        steps = np.diff(one.wheel_angle_rad, axis=0) * wheels.radius_m * np.exp(1j * heading)
        ways = np.vstack([np.zeros(len(WHEELS)), np.cumsum(steps, axis=0)])
        self._margin = _FAR + 2 * _NEAR
        grid_s = begin_s + _STEP_S * np.arange(-self._margin, _EVERY * len(self._edges_s) + self._margin)
        on_grid = interpolate(grid_s, one.t_s, ways.real) + 1j * interpolate(grid_s, one.t_s, ways.imag)
        self._rolled: Complexes = on_grid[_EVERY * _MOVE :] - on_grid[: -_EVERY * _MOVE]
        known = known_at(self._edges_s, one.truth_t_s)
        self._known = (known[_MOVE:] & known[:-_MOVE]).astype(np.float64)

    def of_truth(self, positions_late: int) -> Complexes:
        """Moves (n, 4), m, by the ground truth at the wheels, where its positions are so many steps late."""
        at_s, t_s, pose = self._edges_s + _STEP_S * positions_late, self._one.truth_t_s, self._one.truth_pose
        shifted = np.column_stack(
            [interpolate(at_s, t_s, pose[:, :2]), np.interp(self._edges_s, t_s, pose[:, 2])]
        )
        steps = by_truth(self._edges_s, shifted, self._edges_s, self._one.nominal.geometry)
        sums = np.vstack([np.zeros(len(WHEELS)), np.cumsum(steps, axis=0)])
        return np.asarray((sums[_MOVE:] - sums[:-_MOVE]) * self._known[:, None])

    def misfits(self, moved: Complexes, delays: npt.NDArray[np.int_]) -> Array:
        """Squared misfits (d, 4) for delays of the ground truth, each with the best complex factor."""
        of_truth, out = np.sum(np.abs(moved) ** 2, axis=0), []
        for late in delays.tolist():
            rolled = self._rolled[self._margin - late :: _EVERY][: self.count] * self._known[:, None]
            along = np.abs(np.sum(np.conj(rolled) * moved, axis=0)) ** 2
            out.append(of_truth - along / np.maximum(np.sum(np.abs(rolled) ** 2, axis=0), _LEAST))
        return np.array(out)
