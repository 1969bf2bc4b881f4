"""Finds wrong signs of wheels by comparing their path with ground truth.

A fit cannot mend a wrong sign: all its parameters would end at their bounds. It is named instead, from second
to second and in the robot's own frame, so that neither drift nor a leap decides. Where no single change of a
column explains the difference, a warning says how large it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.blocks import Blocks, reduce_recordings
from hil.datasets.dataset import Recording
from hil.datasets.nominal_robot import Nominal, lever_m
from hil.datasets.truth_jumps import Bools, Rows
from hil.robot.kinematics import WheelGeometry, twist_of_vectors, wheel_vectors
from hil.robot.odometry import integrate

_BLOCK_S, _STRIDE, _LONGEST = 0.1, 10, 20
_WRONG, _RIGHT = 0.6, 0.3
_UNEXPLAINED = 0.2
_ROLLING, _LEAST_ROLLED_RAD = 0.3, 0.05
_PARTS = ((slice(0, 2), 0.3), (slice(2, 3), 0.1))
"""Going, and turning at the wheels: from which share of the whole way each counts on its own."""
_NAMED = 4
_NOTHING_M = 1e-9
LOOK = (
    "look for wheels in another order, a wheel or its steering (delta) with the other sign, x and y "
    "exchanged, a heading (theta) that is not the robot's, a wrong column, unit or bench file"
)
"""What to do about recordings that no geometry explains."""
RATES_AGAINST = "the wheel rates (w) have the other sign than the wheel angles (phi)"
_CONTRADICTS = "the wheels contradict the ground truth, and would agree if {}"
_AGAINST = -0.5
_MIRRORED = np.tile([1.0, -1.0], 4)


@dataclass(frozen=True)
class WrongSigns:
    """Which of R recordings contradict themselves, and would not with another sign.

    Attributes:
        explained: (R,) of each change of a column, by its name: which recordings it explains.
        against: of each change, how many others show that it is not one of all recordings.
    """

    explained: Mapping[str, Bools]
    against: Mapping[str, int]

    @property
    def of_all(self) -> bool:
        """Whether a change may be one of all recordings: half call for it, or as many as speak against it."""
        counts = {words: np.count_nonzero(found) for words, found in self.explained.items()}
        return any(
            2 * n >= len(self.explained[words]) or n >= max(2, self.against[words])
            for words, n in counts.items()
            if n
        )

    def likely(self) -> list[str]:
        """The changes that explain the most recordings; none where nothing is wrong."""
        counts = {words: np.count_nonzero(found) for words, found in self.explained.items()}
        best = max(counts.values())
        return [words for words, n in counts.items() if n == best and n]

    def warning_for(self, index: int) -> str:
        """What is wrong with one recording, and what would have to change; empty where nothing is."""
        changes = [words for words, found in self.explained.items() if found[index]]
        return _CONTRADICTS.format(", or if ".join(changes)) if changes else ""


def wrong_signs(recordings: Sequence[Recording], nominal: Nominal) -> WrongSigns:
    """Find recordings whose wheels contradict the ground truth, and would not with another sign.

    A recording counts where its wheels miss more than 0.6 of the true way or of the true turning, and less
    than 0.3 of both with the sign changed: no geometry, slip or noise does both. It speaks against a change
    where it is the other way round.
    """
    strides = _Strides(reduce_recordings(recordings, _BLOCK_S), nominal.geometry)
    rolled, moved = strides.rolled(), strides.moved()
    missed, changed = strides.missed(rolled, moved), _changed(strides, rolled, moved)
    return WrongSigns(
        {words: (missed > _WRONG) & (share < _RIGHT) for words, share in changed.items()},
        {
            words: int(np.count_nonzero((missed < _RIGHT) & (share > _WRONG)))
            for words, share in changed.items()
        },
    )


def check_signs(recordings: Sequence[Recording], nominal: Nominal, *, of_all: bool = False) -> None:
    """Refuse recordings whose wheels contradict the ground truth or their own rates, see `wrong_signs`.

    Args:
        recordings: to look at.
        nominal: robot that they are read for.
        of_all: refuse only what may be wrong in all of them.

    Raises:
        DataError: names the first file, and the columns that may be wrong.
    """
    found = wrong_signs(recordings, nominal)
    likely = found.likely()
    if of_all and not found.of_all:
        return
    if not likely:
        for one in recordings:
            if rates_against_angles(one):
                raise DataError(
                    _place(one),
                    RATES_AGAINST,
                    expected="both grow as the wheel rolls forward",
                    remedy="change the sign of one in the file",
                )
        return
    wrong = found.explained[likely[0]]
    names = [_place(one) for one, is_wrong in zip(recordings, wrong, strict=True) if is_wrong]
    others = f" ({len(names) - 1} more recordings likewise)" if len(names) > 1 else ""
    raise DataError(
        names[0],
        _CONTRADICTS.format(", or if ".join(likely)) + others,
        expected="phi that grows as its wheel rolls forward; delta and theta counter-clockwise from above",
        remedy="correct that column in the file",
    )


def missed_shares(recordings: Sequence[Recording], geometry: WheelGeometry) -> Array:
    """Share (R,) of the true way or turning, whichever is more, that wheels of this geometry miss."""
    strides = _Strides(reduce_recordings(recordings, _BLOCK_S), geometry)
    return strides.missed(strides.rolled(), strides.moved())


def contradictions(recordings: Sequence[Recording], geometry: WheelGeometry) -> list[str]:
    """One line where wheels of this geometry miss more than a fifth of the true way or turning; else none.

    Slip bursts and spoilt stretches miss up to 0.16, tolerances of a workshop a few hundredths. One steering
    angle with the wrong sign misses 0.25 on a circle, two wheels that are exchanged 0.5.
    """
    missed = missed_shares(recordings, geometry)
    found = [int(i) for i in np.argsort(-missed, kind="stable") if missed[i] > _UNEXPLAINED]
    if not found:
        return []
    others = [recordings[i].name for i in found[1:]]
    more = f" and {len(others) - _NAMED} more" if len(others) > _NAMED else ""
    likewise = f" (likewise, by less: {', '.join(others[:_NAMED])}{more})" if others else ""
    return [
        f"{recordings[found[0]].name}: from second to second the wheels miss {100 * missed[found[0]]:.0f} % "
        f"of the way or turning that the ground truth shows{likewise}; no tolerance explains "
        f"that: {LOOK}"
    ]


def _place(recording: Recording) -> str:
    return recording.sources[0] if recording.sources else recording.name


def rates_against_angles(recording: Recording) -> bool:
    """Whether the wheel rates have the other sign than the wheel angles."""
    if not recording.has_rates:
        return False
    grid_s = np.arange(recording.t_s[0], recording.t_s[-1], 1.0)
    ways = [np.diff(np.interp(grid_s, recording.t_s, angle)) for angle in recording.wheel_angle_rad.T]
    middle_s = 0.5 * (grid_s[1:] + grid_s[:-1])
    rates = [np.interp(middle_s, recording.t_s, rate) for rate in recording.wheel_rate_rad_s.T]
    alike = float(np.vdot(ways, rates))
    return alike < _AGAINST * float(np.linalg.norm(ways) * np.linalg.norm(rates))


class _Strides:
    """R recordings second by second (S strides): how their wheels rolled, and how the robot truly moved.

    A stride ends at the last block of its second whose end the ground truth knows; one across a gap does not
    count.
    """

    def __init__(self, blocks: Blocks, geometry: WheelGeometry) -> None:
        self._blocks, self._geometry = blocks, geometry
        self._ends = _ends(blocks)
        self._poses = self._at_ends(np.concatenate([blocks.start[:, None], blocks.truth], axis=1))
        lasts = np.diff(self._ends, axis=1)
        counted = _rolling(blocks, self._ends) & (lasts > 0) & (lasts <= _LONGEST)
        self._weight = counted[..., None] * np.array([1.0, 1.0, lever_m(geometry)])

    def _at_ends(self, rows: Array) -> Array:
        return np.take_along_axis(rows, self._ends[..., None], axis=1)

    def rolled(self, signs: Array | float = 1.0) -> Array:
        """Moves (R, S, 3) by nominal odometry, of wheel vectors times signs (8,)."""
        x, y = (signs * self._blocks.wheel_rad)[..., 0::2], (signs * self._blocks.wheel_rad)[..., 1::2]
        radius_m, zero_rad = self._geometry.radius_m, self._geometry.steering_zero_rad
        vectors = wheel_vectors(radius_m * np.hypot(x, y), np.arctan2(y, x) - zero_rad)
        motion = twist_of_vectors(self._geometry, vectors)
        return _moves(self._at_ends(integrate(np.zeros(3), motion)))

    def moved(self, signs: Sequence[float] = (1.0, 1.0, 1.0), order: Sequence[int] = (0, 1, 2)) -> Array:
        """True moves (R, S, 3), of poses whose x, y and theta come in this order and with these signs."""
        return _moves(self._poses[..., list(order)] * np.array(signs))

    def missed(self, rolled: Array, moved: Array) -> Array:
        """Share (R,) of the true way or turning, whichever is more, that the wheels miss while they roll."""
        return _share(rolled * self._weight, moved * self._weight)


def _changed(strides: _Strides, rolled: Array, moved: Array) -> dict[str, Array]:
    """Share (R,) that the wheels would miss, by what would have to change; moves (R, S, 3) unchanged."""
    pairs = {
        "the wheel angles (phi) had the other sign": (strides.rolled(-1.0), moved),
        "the steering (delta) had the other sign": (strides.rolled(_MIRRORED), moved),
        "the heading (theta) had the other sign": (rolled, strides.moved((1.0, 1.0, -1.0))),
        "y and the heading (theta) had the other sign": (rolled, moved * (1.0, -1.0, -1.0)),
        "the heading (theta) were half a turn further": (rolled, moved * (-1.0, -1.0, 1.0)),
        "x had the other sign": (rolled, strides.moved((-1.0, 1.0, 1.0))),
        "y had the other sign": (rolled, strides.moved((1.0, -1.0, 1.0))),
        "x and y were exchanged": (rolled, strides.moved(order=(1, 0, 2))),
    }
    return {words: strides.missed(one, other) for words, (one, other) in pairs.items()}


def _ends(blocks: Blocks) -> Rows:
    """(R, S + 1): at which edge the strides of each recording begin and end."""
    edges = np.arange(blocks.known.shape[1] + 1)
    known = np.pad(blocks.known, ((0, 0), (1, 0)), constant_values=True)
    last_known = np.maximum.accumulate(np.where(known, edges, 0), axis=1)
    return np.asarray(last_known[:, ::_STRIDE], dtype=np.int_)


def _rolling(blocks: Blocks, ends: Rows) -> Bools:
    """(R, S): strides in which the wheels roll, so that the noise of a rest does not count."""
    way = np.pad(np.cumsum(blocks.wheel_rad, axis=1), ((0, 0), (1, 0), (0, 0)))
    rolled = np.linalg.norm(np.diff(np.take_along_axis(way, ends[..., None], axis=1), axis=1), axis=2)
    least = np.maximum(_ROLLING * rolled.mean(axis=1, keepdims=True), _LEAST_ROLLED_RAD)
    return np.asarray(rolled > least, dtype=np.bool_)


def _share(moves: Array, true: Array) -> Array:
    """Share (R,) of true moves (R, S, 3), m, that others miss: of the way or of the turning, if worth it."""
    missed, whole = np.zeros(len(true)), _size(true)
    for part, worth in _PARTS:
        way = _size(true[..., part])
        share = _size((moves - true)[..., part]) / way
        missed = np.maximum(missed, np.where((way > worth * whole) & (whole > _NOTHING_M), share, 0.0))
    return missed


def _size(moves: Array) -> Array:
    """Sum (R,) of the lengths of moves (R, S, k)."""
    return np.asarray(np.maximum(np.linalg.norm(moves, axis=2).sum(axis=1), _NOTHING_M), dtype=np.float64)


def _moves(poses: Array) -> Array:
    """Moves (R, S, 3) between poses (R, S + 1, 3), in the frame of the first of both."""
    x, y, turn = np.moveaxis(np.diff(poses, axis=1), -1, 0)
    c, s = np.cos(poses[:, :-1, 2]), np.sin(poses[:, :-1, 2])
    return np.stack([c * x + s * y, c * y - s * x, turn], axis=-1)
