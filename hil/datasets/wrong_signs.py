"""Finds wrong signs of wheels by comparing their path with ground truth.

A fit cannot correct a wrong sign: all its parameters would end at their bounds. So wrong signs are found from
moves of one second in the robot's own frame, where neither drift nor a jump decides. Where no single change
of a column explains the difference, a warning states its size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array, Bools
from hil.datasets.blocks import Blocks, reduce_recordings
from hil.datasets.dataset import Recording
from hil.datasets.nominal_robot import Nominal, lever_m
from hil.datasets.odd_wheels import check_odd_wheels
from hil.datasets.truth_jumps import Rows
from hil.robot.kinematics import WheelGeometry, twist_of_vectors, wheel_vectors
from hil.robot.odometry import integrate

_BLOCK_S, _STRIDE, _LONGEST = 0.1, 10, 20
_WRONG, _RIGHT = 0.6, 0.3
_UNEXPLAINED = 0.2
_ROLLING, _LEAST_ROLLED_RAD = 0.3, 0.05
_PARTS = ((slice(0, 2), 0.3), (slice(2, 3), 0.1))
"""Translation, and turning at the wheels: share of the whole way from which each is judged on its own."""
_NAMED = 4
_NOTHING_M = 1e-9
CHECK_COLUMNS = (
    "look for wheels in another order, a wheel or its steering (delta) with the other sign, x and y "
    "exchanged, a heading (theta) that is not the robot's, a wrong column, unit or bench file"
)
"""Remedy for recordings that no geometry explains."""
RATES_AGAINST = "the wheel rates (w) have the other sign than the wheel angles (phi)"
NO_MOTION = "no wheel turns in it, so it shows nothing of odometry; leave it out, or record a drive"
LEAVE_OUT = "leave it out, or cut it there; look at what the capture system tracked"
"""Remedy for a recording whose ground truth no robot can have followed."""
_CONTRADICTS = "the wheels contradict the ground truth, and would agree if {}"
_AGAINST = -0.5
_MIRRORED = np.tile([1.0, -1.0], 4)


@dataclass(frozen=True)
class WrongSigns:
    """Recordings, of R, that contradict the ground truth and would agree with another sign.

    Attributes:
        explained: mask (R,) of the recordings that each change of a column explains, by description.
        against: number of recordings that each change would spoil, by description.
        missed: share (R,) of the true way or turning that the wheels miss as they are.
    """

    explained: Mapping[str, Bools]
    against: Mapping[str, int]
    missed: Array

    @property
    def of_all(self) -> bool:
        """Whether a change may apply to all recordings: half support it, or as many as it would spoil."""
        counts = {words: np.count_nonzero(found) for words, found in self.explained.items()}
        return any(
            2 * n >= len(self.explained[words]) or n >= max(2, self.against[words])
            for words, n in counts.items()
            if n
        )

    def likely(self) -> list[str]:
        """Changes that explain the most recordings; empty where nothing is wrong."""
        counts = {words: np.count_nonzero(found) for words, found in self.explained.items()}
        best = max(counts.values())
        return [words for words, n in counts.items() if n == best and n]

    def warning_for(self, index: int) -> str:
        """Warning for one recording that names the changes that would correct it; empty where it is right."""
        changes = [words for words, found in self.explained.items() if found[index]]
        return _CONTRADICTS.format(", or if ".join(changes)) if changes else ""


def wrong_signs(recordings: Sequence[Recording], nominal: Nominal) -> WrongSigns:
    """Find recordings whose wheels contradict the ground truth, and would agree with another sign.

    A recording counts if its wheels miss more than 0.6 of the true way or of the true turning, and less than
    0.3 of both with the sign changed: no geometry, slip or noise does both. It counts against a change in the
    reverse case.
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
        missed,
    )


def check_signs(recordings: Sequence[Recording], nominal: Nominal, *, of_all: bool = False) -> None:
    """Refuse recordings whose wheels contradict the ground truth or their own rates.

    See `wrong_signs` for columns that are wrong in common, and `odd_wheels` for single wheels.

    Args:
        recordings: recordings to check.
        nominal: robot that they are read for.
        of_all: True to refuse only signs that may be wrong in all of them.

    Raises:
        DataError: names the first file, and the columns that may be wrong.
    """
    recordings = [one for one in recordings if not one.contradictions and not one.of_twist]
    if not recordings:
        return
    found = wrong_signs(recordings, nominal)
    likely = found.likely()
    if not likely:
        far = [one for one, share in zip(recordings, found.missed, strict=True) if share > _UNEXPLAINED]
        if not of_all or 2 * len(far) >= len(recordings):
            check_odd_wheels(far, nominal)
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
    """Share (R,) of the true way or turning, the larger one, that wheels of this geometry miss."""
    strides = _Strides(reduce_recordings(recordings, _BLOCK_S), geometry)
    return strides.missed(strides.rolled(), strides.moved())


def is_at_rest(wheel_angle_rad: Array) -> bool:
    """Whether no wheel turns by more than 0.05 rad, of angles (n, 4); rows with NaN do not count."""
    known = wheel_angle_rad[np.isfinite(wheel_angle_rad).all(axis=1)]
    return len(known) > 0 and float(np.ptp(known, axis=0).max()) < _LEAST_ROLLED_RAD


def without_motion(recordings: Sequence[Recording]) -> list[str]:
    """One line if there are recordings in which no wheel turns; else none."""
    found = [one.name for one in recordings if is_at_rest(one.wheel_angle_rad)]
    return [f"{found[0]}: {NO_MOTION}{_likewise(found[1:])}"] if found else []


def contradictions(recordings: Sequence[Recording], geometry: WheelGeometry) -> list[str]:
    """One line if wheels of this geometry miss more than a fifth of the true way or turning; else none.

    Slip bursts and corrupted stretches miss up to 0.16, workshop tolerances a few hundredths. One steering
    angle with the wrong sign misses 0.25 on a circle, two exchanged wheels 0.5. A recorded twist is compared
    by `hil.datasets.sensor_checks`.
    """
    impossible = [one for one in recordings if one.contradictions]
    if impossible:
        first, *others = impossible
        more = _likewise([one.name for one in others])
        return [f"{first.name}: {first.contradictions[0]}{more}; {LEAVE_OUT}"]
    recordings = [one for one in recordings if not one.of_twist]
    if not recordings:
        return []
    strides = _Strides(reduce_recordings(recordings, _BLOCK_S), geometry)
    missed = strides.missed(strides.rolled(), strides.moved())
    found = [int(i) for i in np.argsort(-missed, kind="stable") if missed[i] > _UNEXPLAINED]
    if not found:
        return []
    likewise = _likewise([recordings[i].name for i in found[1:]], "likewise, by less")
    return [
        f"{recordings[found[0]].name}: from second to second the wheels miss {100 * missed[found[0]]:.0f} % "
        f"of the way or turning that the ground truth shows{likewise}; no tolerance explains "
        f"that: {CHECK_COLUMNS}"
    ]


def _likewise(others: Sequence[str], how: str = "likewise") -> str:
    more = f" and {len(others) - _NAMED} more" if len(others) > _NAMED else ""
    return f" ({how}: {', '.join(others[:_NAMED])}{more})" if others else ""


def _place(recording: Recording) -> str:
    return recording.sources[0] if recording.sources else recording.name


def rates_against_angles(recording: Recording) -> bool:
    """Whether the wheel rates have the opposite sign of the wheel angles."""
    if not recording.has_rates:
        return False
    grid_s = np.arange(recording.t_s[0], recording.t_s[-1], 1.0)
    ways = [np.diff(np.interp(grid_s, recording.t_s, angle)) for angle in recording.wheel_angle_rad.T]
    middle_s = 0.5 * (grid_s[1:] + grid_s[:-1])
    rates = [np.interp(middle_s, recording.t_s, rate) for rate in recording.wheel_rate_rad_s.T]
    alike = float(np.vdot(ways, rates))
    return alike < _AGAINST * float(np.linalg.norm(ways) * np.linalg.norm(rates))


class _Strides:
    """R recordings in strides of one second (S strides): moves by the wheels, and true moves.

    A stride ends at the last block of its second with known ground truth; a stride across a gap does not
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
        """Moves (R, S, 3) by nominal odometry, from wheel vectors times signs (8,)."""
        x, y = (signs * self._blocks.wheel_rad)[..., 0::2], (signs * self._blocks.wheel_rad)[..., 1::2]
        radius_m, zero_rad = self._geometry.radius_m, self._geometry.steering_zero_rad
        vectors = wheel_vectors(radius_m * np.hypot(x, y), np.arctan2(y, x) - zero_rad)
        motion = twist_of_vectors(self._geometry, vectors)
        return _moves(self._at_ends(integrate(np.zeros(3), motion)))

    def moved(self, signs: Sequence[float] = (1.0, 1.0, 1.0), order: Sequence[int] = (0, 1, 2)) -> Array:
        """True moves (R, S, 3), with x, y and theta of the poses reordered and multiplied by signs."""
        return _moves(self._poses[..., list(order)] * np.array(signs))

    def missed(self, rolled: Array, moved: Array) -> Array:
        """Share (R,) of the true way or turning, the larger one, that the wheels miss while they roll."""
        return _share(self.counted(rolled), self.counted(moved))

    def counted(self, moves: Array) -> Array:
        """Moves (R, S, 3), m, while the wheels roll, else 0; turning counts at the wheels."""
        return np.asarray(moves * self._weight, dtype=np.float64)


def _changed(strides: _Strides, rolled: Array, moved: Array) -> dict[str, Array]:
    """Share (R,) that the wheels would miss for each change of a column; `rolled`, `moved`: unchanged."""
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
    """Edge indices (R, S + 1) at which the strides of each recording begin and end."""
    edges = np.arange(blocks.known.shape[1] + 1)
    known = np.pad(blocks.known, ((0, 0), (1, 0)), constant_values=True)
    last_known = np.maximum.accumulate(np.where(known, edges, 0), axis=1)
    return np.asarray(last_known[:, ::_STRIDE], dtype=np.int_)


def _rolling(blocks: Blocks, ends: Rows) -> Bools:
    """Mask (R, S) of strides in which the wheels roll; noise at rest does not count."""
    way = np.pad(np.cumsum(blocks.wheel_rad, axis=1), ((0, 0), (1, 0), (0, 0)))
    rolled = np.linalg.norm(np.diff(np.take_along_axis(way, ends[..., None], axis=1), axis=1), axis=2)
    least = np.maximum(_ROLLING * rolled.mean(axis=1, keepdims=True), _LEAST_ROLLED_RAD)
    return np.asarray(rolled > least, dtype=np.bool_)


def _share(moves: Array, true: Array) -> Array:
    """Share (R,) of true moves (R, S, 3), m, that other moves miss, in way or turning where these matter."""
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
    """Moves (R, S, 3) between consecutive poses (R, S + 1, 3), in the frame of the earlier one."""
    x, y, turn = np.moveaxis(np.diff(poses, axis=1), -1, 0)
    c, s = np.cos(poses[:, :-1, 2]), np.sin(poses[:, :-1, 2])
    return np.stack([c * x + s * y, c * y - s * x, turn], axis=-1)
