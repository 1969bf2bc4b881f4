"""Finds wrong signs of wheels by comparing their path with ground truth.

A fit cannot correct a wrong sign: all its parameters would end at their bounds. So wrong signs are found from
moves of one second in the robot's own frame, where neither drift nor a jump decides. Where no single change
of a column explains the difference, a warning states its size.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array, Bools
from hil.core.signals import WHEELS
from hil.datasets.fit_blocks import reduce_recordings
from hil.datasets.nominal_robot import Nominal
from hil.datasets.odd_wheels import alike, check_odd_wheels
from hil.datasets.strides import BLOCK_S, LEAST_ROLLED_RAD, Strides
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import WheelGeometry

_WRONG, _RIGHT = 0.6, 0.3
_UNEXPLAINED = 0.2
_NAMED = 4
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
_ORDERS = tuple(itertools.permutations(range(4)))[1:]
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

    @property
    def worth(self) -> int:
        """Number of recordings that the best change explains beyond those that it would spoil; 0 at least."""
        counts = {words: int(np.count_nonzero(found)) for words, found in self.explained.items()}
        return max(0, *(count - self.against[words] for words, count in counts.items()))

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
    reverse case. Where another order of the wheels explains more recordings than any sign, orders are named.
    """
    strides = Strides(reduce_recordings(recordings, BLOCK_S), nominal.geometry)
    rolled, moved = strides.rolled(), strides.moved()
    missed = strides.missed(rolled, moved)
    signs = _judged(missed, _changed(strides, rolled, moved))
    wrong = int(np.count_nonzero(missed > _WRONG))
    if signs.worth >= wrong:
        return signs
    orders = _judged(
        missed, {_held(one): strides.missed(strides.rolled(order=one), moved) for one in _ORDERS}
    )
    return orders if orders.worth > signs.worth else signs


def _held(order: Sequence[int]) -> str:
    return f"phi1 to phi4 and delta1 to delta4 held the wheels {', '.join(WHEELS[i] for i in order)}"


def _judged(missed: Array, changed: Mapping[str, Array]) -> WrongSigns:
    """What changes explain and spoil, by the shares (R,) that the wheels miss now and with each change."""
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
        check_odd_wheels(
            far if not of_all or 2 * len(far) >= len(recordings) else alike(far, nominal), nominal
        )
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
    strides = Strides(reduce_recordings(recordings, BLOCK_S), geometry)
    return strides.missed(strides.rolled(), strides.moved())


def is_at_rest(wheel_angle_rad: Array) -> bool:
    """Whether no wheel turns by more than 0.05 rad, of angles (n, 4); rows with NaN do not count."""
    known = wheel_angle_rad[np.isfinite(wheel_angle_rad).all(axis=1)]
    return len(known) > 0 and float(np.ptp(known, axis=0).max()) < LEAST_ROLLED_RAD


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
    strides = Strides(reduce_recordings(recordings, BLOCK_S), geometry)
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


def _changed(strides: Strides, rolled: Array, moved: Array) -> dict[str, Array]:
    """Share (R,) that the wheels would miss for each change of a column; `rolled`, `moved`: unchanged."""
    pairs = {
        "the wheel angles (phi) had the other sign": (strides.rolled(-1.0), moved),
        "the steering (delta) had the other sign": (strides.rolled(_MIRRORED), moved),
        "the heading (theta) had the other sign": (rolled, strides.moved((1.0, 1.0, -1.0))),
        "y and the heading (theta) had the other sign": (rolled, moved * (1.0, -1.0, -1.0)),
        "the heading (theta) were twice as large": (rolled, strides.moved((1.0, 1.0, 2.0))),
        "the heading (theta) were half a turn further": (rolled, moved * (-1.0, -1.0, 1.0)),
        "x had the other sign": (rolled, strides.moved((-1.0, 1.0, 1.0))),
        "y had the other sign": (rolled, strides.moved((1.0, -1.0, 1.0))),
        "x and y were exchanged": (rolled, strides.moved(order=(1, 0, 2))),
    }
    return {words: strides.missed(one, other) for words, (one, other) in pairs.items()}
