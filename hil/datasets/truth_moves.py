"""Moves of ground truth and wheels over 0.2 s, and how causes of their difference change them.

Each cause gives one or two columns: the change of all moves for a coefficient of 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from hil.core.geometry import Array, Bools
from hil.core.signals import WHEELS
from hil.datasets.nominal_robot import lever_m
from hil.datasets.sampling import LONGEST_GAP_S, interpolate, is_slow, wheel_steps
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import twist_of_vectors, wheel_vectors
from hil.robot.odometry import integrate

GRID_S, WINDOW_S = 0.02, 0.2
_BEND_S = 0.2
"""Step of the second derivative by the delay, and of the derivative by that of a wheel, s."""
_GAPS_LONGER = 1.5
_ROUNDS, _USUAL = 5, 1.5
_REST_S, _RESTS_RAD = 0.3, 0.02
_LEAST = 1e-12

SMOOTHED, UNEVEN, DRIFT, SKEW = "smoothed", "uneven", "drift", "skew"
"""Causes of the ground truth; those of single wheels have the names of the wheels."""

Complexes: TypeAlias = npt.NDArray[np.complex128]
Moves: TypeAlias = tuple[Complexes, Array]
"""Translations x + iy, m, in the frame at the begin of each move, and turns, rad."""


@dataclass(frozen=True)
class Drive:
    """Moves (k) of the ground truth of a recording, and its wheels.

    Attributes:
        begin_s: (k,) begin of each move by the clock of the ground truth, s.
        end_s: (k,) end.
        way: (k,) translations, m.
        turn: (k,) turns, rad.
        heading: (k,) heading of the ground truth at the begin, rad.
        middle_s: middle of the ground truth, s; `half_s` half its length.
        t_s: (n,) times of the wheel rows, s.
        by_wheels: (n, 3) poses by nominal odometry from 0.
        of_wheels: (n, 12) sums of what each wheel adds to the motion of the body: x, y, turn of each.
        known_s: span in which the motion of the wheels is known: beyond their rows only where they rest.
        lever_m: distance of the wheels from the middle.
    """

    begin_s: Array
    end_s: Array
    way: Complexes
    turn: Array
    heading: Array
    middle_s: float
    half_s: float
    t_s: Array
    by_wheels: Array
    of_wheels: Array
    known_s: tuple[float, float]
    lever_m: float

    @classmethod
    def of(cls, recording: Recording) -> Drive | None:
        """The moves of a recording; None where there are none."""
        at_s, pose, wheels = recording.truth_t_s, recording.truth_pose, recording.nominal.geometry
        begin_s, end_s, (way, turn) = _true_moves(at_s, pose)
        if len(begin_s) == 0:
            return None
        rotation, steering = wheel_steps(recording, recording.t_s, "position")
        vectors = wheel_vectors(rotation * wheels.radius_m, steering - wheels.steering_zero_rad)
        alone = np.repeat(np.eye(len(WHEELS)), 2, axis=1)
        steps = np.hstack([twist_of_vectors(wheels, vectors * own, "exact") for own in alone])
        return cls(
            begin_s,
            end_s,
            way,
            turn,
            np.interp(begin_s, at_s, pose[:, 2]),
            0.5 * float(at_s[0] + at_s[-1]),
            0.5 * float(at_s[-1] - at_s[0]),
            recording.t_s,
            integrate(np.zeros(3), twist_of_vectors(wheels, vectors, "exact")),
            np.vstack([np.zeros(3 * len(WHEELS)), np.cumsum(steps, axis=0)]),
            _known_from_to(recording),
            lever_m(wheels),
        )

    @property
    def wanted(self) -> Array:
        """Moves of the ground truth (3 k,), m: ahead, left, turned at the wheels."""
        return np.concatenate([self.way.real, self.way.imag, self.lever_m * self.turn])

    @property
    def turns_rad_s(self) -> float:
        """Mean rate, by path, at which the body turns along it; 0 where it turns on the spot."""
        way_m, lasts_s = np.abs(self.way), self.end_s - self.begin_s
        if way_m.sum() <= self.lever_m * np.abs(self.turn).sum():
            return 0.0
        return float(way_m @ self.turn) / max(float(way_m @ lasts_s), _LEAST)

    def heading_beyond_path(self, late_s: float, fast: float) -> float:
        """Change of the heading against the direction of the path, by turn; the wheels say how they differ.

        On a curve it is 0 whatever the distances of the wheels; 0 also where the body turns on the spot.
        Moves in which the robot slips count less (Huber's weights).
        """
        if self.turns_rad_s == 0.0:
            return 0.0
        beside = np.conj(self.way) * self._moves(late_s, fast)[0]
        angle, left = np.angle(beside * np.conj(beside.sum())), np.zeros(len(beside))
        slope = 0.0
        for _ in range(_ROUNDS):
            usual = float(np.median(np.abs(left)))
            weight = np.abs(beside) * np.minimum(1.0, _USUAL * usual / np.maximum(np.abs(left), _LEAST))
            weight = np.abs(beside) if usual < _LEAST else weight
            weight /= max(float(weight.sum()), _LEAST)
            since, off = self.heading - weight @ self.heading, angle - weight @ angle
            slope = float((weight * since) @ off) / max(float((weight * since) @ since), _LEAST)
            left = off - slope * since
        return slope

    @property
    def overlap(self) -> float:
        """Number of moves that overlap."""
        return max(1.0, WINDOW_S / float(np.median(np.diff(self.begin_s, append=self.end_s[-1]))))

    def relation(
        self, late_s: float, fast: float, turned: tuple[complex, float]
    ) -> tuple[Array, Bools, Bools]:
        """Columns (3 k, 7), and masks (k,) of moves in the wheels' time and of those in which they roll.

        The columns: delay, rate of the clock, what the wheels say (turned by a quarter as well), their turns,
        the two coordinates of the tracked point.
        """
        (u, v), (du, dv) = self._moves(late_s, fast), self._speeds(late_s, fast, turned)
        since, none, carried = self.begin_s - self.middle_s, np.zeros(len(v)), np.exp(1j * self.turn) - 1.0
        rows = self._columns(
            (du, du * since, u, 1j * u, none, carried, 1j * carried),
            (dv, dv * since, none, none, v, none, none),
        )
        begin_s, end_s = self._by_the_wheels_clock(late_s, fast)
        seen = (begin_s >= self.known_s[0]) & (end_s <= self.known_s[1])
        return rows, seen, np.abs(u) + np.abs(v) > _LEAST

    def causes(
        self, late_s: float, fast: float, turned: tuple[complex, float]
    ) -> tuple[Array, dict[str, Array], dict[str, Array]]:
        """Columns (3 k, 2) of turns by slip, and those of each cause, (3 k, 1) or (3 k, 2).

        Causes that show where the motion changes: `SMOOTHED`, an average over times of this variance, s^2;
        `UNEVEN`, bends of its clock, s; one wheel whose columns are late, s. Others: `DRIFT` of its heading,
        rad/s; `SKEW`, axes that differ in scale or are sheared, both halved.
        """
        (u, v), (du, dv) = self._moves(late_s, fast), self._speeds(late_s, fast, turned)
        u, v, none = turned[0] * u, turned[1] * v, np.zeros(len(v))
        since = self.begin_s - self.middle_s
        share = since / self.half_s
        bends = (1.5 * share**2 - 0.5, 2.5 * share**3 - 1.5 * share)
        skewed = np.conj(u * np.exp(2j * self.heading))
        (u1, v1), (u0, v0) = (self._moves(late_s + step, fast) for step in (_BEND_S, -_BEND_S))
        bent = (turned[0] * (u1 + u0) - 2.0 * u, turned[1] * (v1 + v0) - 2.0 * v)
        changes = {
            SMOOTHED: self._columns([0.5 / _BEND_S**2 * bent[0]], [0.5 / _BEND_S**2 * bent[1]]),
            UNEVEN: self._columns([du * bend for bend in bends], [dv * bend for bend in bends]),
        }
        for wheel, (way, turn) in zip(WHEELS, self._later(late_s, fast), strict=True):
            changes[wheel] = self._columns([turned[0] * way], [turned[1] * turn])
        steady = {
            DRIFT: self._columns([-1j * since * u], [self.end_s - self.begin_s]),
            SKEW: self._columns([skewed, 1j * skewed], [none, none]),
        }
        return self._columns([none, none], [u.real, u.imag]), changes, steady

    def _columns(self, translations: Sequence[npt.ArrayLike], turns: Sequence[Array]) -> Array:
        """Columns (3 k, c) of c translations (k,), m, and turns (k,), rad."""
        way = np.stack([np.asarray(one, dtype=np.complex128) for one in translations], axis=1)
        turn = self.lever_m * np.stack(turns, axis=1)
        return np.concatenate([way.real, way.imag, turn])

    def _by_the_wheels_clock(self, late_s: float, fast: float) -> tuple[Array, Array]:
        begin, end = (t - late_s - fast * (t - self.middle_s) for t in (self.begin_s, self.end_s))
        return begin, end

    def _moves(self, late_s: float, fast: float) -> Moves:
        """Moves by the wheels where the ground truth is so late and fast."""
        begin, end = self._by_the_wheels_clock(late_s, fast)
        return _moves(*(interpolate(t, self.t_s, self.by_wheels) for t in (begin, end)))

    def _speeds(self, late_s: float, fast: float, turned: tuple[complex, float]) -> Moves:
        """Derivatives of the moves by the delay."""
        (u1, v1), (u0, v0) = (self._moves(late_s + step, fast) for step in (GRID_S, -GRID_S))
        return turned[0] * (u1 - u0) / (2.0 * GRID_S), turned[1] * (v1 - v0) / (2.0 * GRID_S)

    def _later(self, late_s: float, fast: float) -> list[Moves]:
        """Derivatives of the moves by how late the columns of each wheel are."""
        begin, end = self._by_the_wheels_clock(late_s, fast)
        before, after = (
            interpolate(end + step, self.t_s, self.of_wheels)
            - interpolate(begin + step, self.t_s, self.of_wheels)
            for step in (-_BEND_S, _BEND_S)
        )
        rates = ((after - before) / (2.0 * _BEND_S)).reshape(len(begin), -1, 3)
        return [(rates[:, i, 0] + 1j * rates[:, i, 1], rates[:, i, 2]) for i in range(rates.shape[1])]


def _known_from_to(recording: Recording) -> tuple[float, float]:
    """Span, s, in which the wheels' motion is known: beyond their rows only where they rest there."""
    t_s, angle = recording.t_s, recording.wheel_angle_rad
    rests = [
        float(np.ptp(angle[rows], axis=0).max(initial=0.0)) < _RESTS_RAD
        for rows in (t_s < t_s[0] + _REST_S, t_s > t_s[-1] - _REST_S)
    ]
    return (-np.inf if rests[0] else float(t_s[0])), (np.inf if rests[1] else float(t_s[-1]))


def _true_moves(at_s: Array, pose: Array) -> tuple[Array, Array, Moves]:
    """Begin and end (k,), s, of moves of ground truth (n, 3), and the moves; row by row where it is slow."""
    if is_slow(at_s):
        lasts_s = np.diff(at_s)
        whole = lasts_s <= _GAPS_LONGER * float(np.median(lasts_s))
        return at_s[:-1][whole], at_s[1:][whole], _moves(pose[:-1][whole], pose[1:][whole])
    grid_s, n = np.arange(at_s[0], at_s[-1], GRID_S), round(WINDOW_S / GRID_S)
    poses, known = interpolate(grid_s, at_s, pose), known_at(grid_s, at_s)
    both = known[n:] & known[:-n]
    return grid_s[:-n][both], grid_s[n:][both], _moves(poses[:-n][both], poses[n:][both])


def _moves(begin: Array, end: Array) -> Moves:
    x, y, turn = (end - begin).T
    return (x + 1j * y) * np.exp(-1j * begin[:, 2]), turn


def known_at(grid_s: Array, at_s: Array) -> Bools:
    """Mask of instants (k,) at which the ground truth, rows (m,), has no gap."""
    lasts_s = np.diff(at_s)
    longest_s = max(LONGEST_GAP_S, _GAPS_LONGER * float(np.median(lasts_s)))
    behind = np.clip(np.searchsorted(at_s, grid_s), 1, len(at_s) - 1)
    return np.asarray(lasts_s[behind - 1] <= longest_s, dtype=np.bool_)
