"""Rows of a wheel log and its ground truth that can be used: cleaned, in a time that both cover.

What was left out is counted by name. What cannot be used is refused.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array, Bools
from hil.datasets.cleaning import Log, clean, count, emptiest, with_angles
from hil.datasets.partial_rows import completed
from hil.datasets.truth_jumps import WheelMotion, find_jumps
from hil.datasets.unit_check import check_repeats, check_stamp_jumps, check_time

FROZEN = "ground-truth rows that repeat an earlier pose while the wheels roll (a frozen source) left out"
_ROLLED_RAD, _LITTLE_RAD = 0.08, 0.02
_MIN_ROWS = 20
_FROZEN_S = 0.5
_WHEEL_COLUMNS = ("t", *(f"phi{i}" for i in range(1, 5)), *(f"delta{i}" for i in range(1, 5)))
_TRUTH_COLUMNS = ("t", "x", "y", "theta")
_SPANS = ((3.15576e7, "years"), (86400.0, "days"), (3600.0, "hours"), (1.0, "s"))


class Rows(NamedTuple):
    """Cleaned rows: stamps (n,), s, increasing, values (n, k), and receive stamps (n,), s."""

    t_s: Array
    values: Array
    receive_s: Array

    def only(self, keep: Bools) -> Rows:
        """The rows of a mask (n,)."""
        return Rows(self.t_s[keep], self.values[keep], self.receive_s[keep])


def usable(where: str, wheels: Log, truth: Log, repairs: dict[str, int]) -> tuple[Rows, Rows]:
    """Cleaned rows of the wheels and of the ground truth.

    Args:
        where: the file, for messages.
        wheels: wheel log.
        truth: ground truth.
        repairs: counts of repairs by name; changed in place.

    Raises:
        DataError: too few rows, too little time that both cover, or stamps that are no times.
    """
    rows = usable_wheels(where, wheels, repairs)
    check_repeats(where, "ground-truth", truth.t_s, truth.values)
    truth = completed(truth, 3, "ground-truth", (2,), repairs)
    poses = Rows(*clean(truth, 3, "ground-truth", repairs))
    if len(poses.t_s) < _MIN_ROWS:
        raise DataError(
            where,
            f"only {len(poses.t_s)} usable ground-truth rows{emptiest(truth, _TRUTH_COLUMNS)}",
            expected="x, y and theta from motion capture",
            remedy="a bag without ground truth can be replayed, with no [truth] in its --topics file",
        )
    shared_s = min(rows.t_s[-1], poses.t_s[-1]) - max(rows.t_s[0], poses.t_s[0])
    if shared_s < 1.0:
        raise _apart(where, float(poses.t_s[0] - rows.t_s[0]), float(shared_s))
    check_stamp_jumps(where, poses.t_s)
    return rows, poses


def usable_wheels(where: str, wheels: Log, repairs: dict[str, int]) -> Rows:
    """Cleaned rows of the wheels; arguments as of `usable`.

    Raises:
        DataError: too few rows, or stamps that are no times.
    """
    check_time(where, wheels.t_s)
    check_repeats(where, "wheel", wheels.t_s, wheels.values)
    wheels = completed(with_angles(wheels, repairs), 8, "wheel", range(4, 8), repairs)
    rows = Rows(*clean(wheels, 8, "wheel", repairs))
    if len(rows.t_s) < _MIN_ROWS:
        raise DataError(
            where,
            f"only {len(rows.t_s)} usable wheel rows{emptiest(wheels, _WHEEL_COLUMNS)}",
            expected=f"at least {_MIN_ROWS}",
        )
    check_stamp_jumps(where, rows.t_s)
    return rows


def _apart(where: str, later_s: float, shared_s: float) -> DataError:
    """Error of logs that share less than a second: begun together, or with the time between their begins."""
    size, unit = next((size, unit) for size, unit in _SPANS if abs(later_s) >= size or size == 1.0)
    word = "after" if later_s > 0 else "before"
    if abs(later_s) < 1.0:
        return DataError(
            where,
            f"wheels and ground truth begin together and share {max(shared_s, 0.0):.2f} s by their stamps",
            expected="stamps in seconds, >= 1 s of both",
            remedy="multiply stamps in minutes by 60, those in hours by 3600; or record for longer",
        )
    return DataError(
        where,
        f"wheels and ground truth share {max(shared_s, 0.0):.2f} s: the ground truth begins "
        f"{abs(later_s):.3f} s ({abs(later_s) / size:.3g} {unit}) {word} the wheels",
        expected="stamps of one clock, >= 1 s of both",
        remedy=f"if both began together, subtract {later_s:.3f} s from the stamps of the ground truth; else "
        "stamp both by the computer that records them",
    )


def without_frozen(
    where: str, truth: Rows, t_s: Array, angle: Array, end_s: float, repairs: dict[str, int]
) -> Rows:
    """Ground truth without rows that repeat an earlier pose while the wheels roll.

    Args:
        where: the file, for messages.
        truth: rows of the ground truth.
        t_s: (n,) times of the wheel rows, s.
        angle: (n, 4) cumulative wheel angles, rad.
        end_s: end of the time that both cover, s.
        repairs: counts of repairs by name; changed in place.

    Raises:
        DataError: the last pose repeats to the end while the wheels roll.
    """
    fresh = _fresh(truth.t_s, truth.values, t_s, angle)
    left = truth.only(fresh)
    frozen_s = end_s - left.t_s[-1]
    count(repairs, FROZEN, np.count_nonzero(~fresh))
    if len(left.t_s) < _MIN_ROWS or frozen_s > _FROZEN_S:
        raise DataError(
            where,
            f"the ground truth repeats its last pose for {frozen_s:.1f} s while the wheels roll",
            expected="a source that goes on to the end",
            remedy="look at what the capture system sent",
        )
    return left


def _fresh(truth_t_s: Array, pose: Array, t_s: Array, angle: Array) -> Bools:
    """Mask of ground-truth rows (m,) that do not repeat the pose before while the wheels roll.

    Poses equal to the last bit count as repeated where a wheel turns by 0.08 rad (2 mm) meanwhile, starting
    with the row at which it has turned by a quarter of that. A robot at rest may be measured without noise.

    Args:
        truth_t_s: (m,) times of the ground truth, s, increasing.
        pose: (m, 3) poses.
        t_s: (n,) times of the wheel rows, s.
        angle: (n, 4) cumulative wheel angles, rad.
    """
    changed = np.concatenate([[True], np.any(np.diff(pose, axis=0) != 0.0, axis=1)])
    first = np.maximum.accumulate(np.where(changed, np.arange(len(pose)), 0))
    wheels = np.column_stack([np.interp(truth_t_s, t_s, column) for column in angle.T])
    rolled = np.max(np.abs(wheels - wheels[first]), axis=1)
    most = np.zeros(len(pose))
    np.maximum.at(most, first, rolled)
    return np.asarray((most[first] < _ROLLED_RAD) | (rolled < _LITTLE_RAD), dtype=np.bool_)


def without_jumps(
    where: str, truth: Rows, wheels: WheelMotion, repairs: dict[str, int]
) -> tuple[Rows, tuple[str, ...]]:
    """Ground truth without rows that leap away, and the first jump that lasts, in words.

    Args:
        where: the file, for messages.
        truth: rows of the ground truth.
        wheels: motion by the wheels.
        repairs: counts of repairs by name; changed in place.

    Raises:
        DataError: less than half of the rows are left.
    """
    found = find_jumps(truth.t_s, truth.values, wheels)
    dropped = np.count_nonzero(~found.keep) - found.resting
    if 2 * dropped > len(found.keep):
        raise DataError(
            where,
            f"the ground truth (x, y, theta) leaps: {dropped} of {len(found.keep)} rows are out of reach",
            expected="a path that the robot can have driven",
            remedy="look at what the capture system tracked",
        )
    count(repairs, "ground-truth rows that leap away and back dropped", dropped)
    count(repairs, "ground-truth rows beyond a leap, in which the robot rests, dropped", found.resting)
    more = f" (the first of {len(found.lasting)} such steps)" if len(found.lasting) > 1 else ""
    return truth.only(found.keep), tuple(jump.in_words() + more for jump in found.lasting[:1])
