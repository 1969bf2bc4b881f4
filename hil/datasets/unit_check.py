"""Checks that a recording is in seconds, metres and radians, by what is possible for the robot.

Wheels and ground truth measured the same drive. Each bounds the other, whatever the robot's size. Every bound
has a factor of margin that no slip, tolerance or wrong bench file reaches; a wrong unit exceeds it.
"""

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.cleaning import MIN_STEP_S
from hil.datasets.nominal_robot import Nominal, lever_m
from hil.datasets.wrong_units import UnitError

_SLOWEST_ROW_S = 0.5
_UNITS_OF_TIME = ((3e2, "milliseconds", "1e3"), (3e5, "microseconds", "1e6"), (np.inf, "nanoseconds", "1e9"))
_DAY_S = 86400.0
_FURTHER, _FURTHER_M = 20.0, 1.0
_TURNS_MORE, _WRAPPED_RAD = 5.0, 2.0 * np.pi
_ROLLS_MORE, _ROLLS_M = 10.0, 0.5
_STRIDE_S = 1.0
_REPEATED = 0.75
_COUNT_DEG, _COUNTS, _COUNT_OFF = 360.0 / 4096.0, 3, 2e-3


def check_time(where: str, t_s: Array) -> None:
    """Refuse stamps (n,) of wheel rows, as in the file, that are not in seconds; raises `DataError`.

    The fastest wheel (4.9 rad/s) makes half a turn in 0.64 s: rows further apart determine neither how far a
    wheel rolled nor how it was steered meanwhile. No servo bus is read more often than a thousand times a
    second, so in milliseconds rows are 1 apart or more. The limit of 0.5 lies between both. It applies to the
    median, so gaps, repeats and damaged stamps do not matter.
    """
    finite = t_s[np.isfinite(t_s)]
    with np.errstate(over="ignore"):
        step = float(np.median(np.diff(np.sort(finite)))) if len(finite) > 1 else 0.0
    if step <= _SLOWEST_ROW_S:
        return
    unit, factor = next((name, factor) for below, name, factor in _UNITS_OF_TIME if step < below)
    raise UnitError(
        where,
        f"time (t) goes on by {step:.3g} from row to row (median)",
        {"t": 1.0 / float(factor)},
        expected=f"seconds, at most {_SLOWEST_ROW_S:g} from row to row",
        remedy=f"divide it by {factor} if it is in {unit}",
    )


def check_stamp_jumps(where: str, t_s: Array) -> None:
    """Refuse increasing times (n,), s, with more than a day between two rows, as from a damaged stamp.

    A drive is shorter, and interpolation across such a gap is meaningless. Raises `DataError`.
    """
    leap_s = float(np.max(np.diff(t_s)))
    if leap_s > _DAY_S:
        raise DataError(
            where,
            f"time (t) leaps by {leap_s:.3g} s from one row to the next",
            expected=f"at most {_DAY_S:g} s",
            remedy="take out the rows whose stamps are damaged",
        )


def check_repeats(where: str, kind: str, t_s: Array, values: Array) -> None:
    """Refuse rows of which three quarters have the stamp of another row, and other values.

    Rows of one stamp are copies, and all but the first are dropped. Here they would be most of the drive:
    stamps in whole seconds, or nanoseconds that hold milliseconds.

    Args:
        where: the file, for messages.
        kind: name of the rows in the message.
        t_s: (n,) stamps as in the file, s.
        values: (n, k) values of the rows.

    Raises:
        DataError: names the number of such rows.
    """
    finite = np.isfinite(t_s)
    order = np.argsort(t_s[finite], kind="stable")
    same = np.diff(t_s[finite][order]) <= MIN_STEP_S
    rows = values[finite][order]
    other = np.any((rows[1:] > rows[:-1]) | (rows[1:] < rows[:-1]), axis=1)
    repeated = int(np.count_nonzero(same & other))
    if repeated > _REPEATED * len(t_s):
        raise DataError(
            where,
            f"{repeated} of {len(t_s)} {kind} rows have the stamp of another row, and other values",
            expected="a stamp of its own for each row",
            remedy="look at the digits and the unit of the stamps: whole seconds are too coarse, and "
            "nanoseconds must not hold milliseconds",
        )


def check_units(
    where: str, angle: Array, steering: Array, truth_t_s: Array, pose: Array, heading: Array, nominal: Nominal
) -> None:
    """Refuse angles that are not in radians and positions that are not in metres.

    * Steering is not in counts of degrees.
    * The robot moves at most 20 times as far as its wheels roll, plus 1 m: millimetres are 1000 times.
    * It turns at most 5 times as far as its wheels can roll around its middle, since no wheel is so wrong,
      plus one turn, by which a wrapped heading may jump: degrees are 57 times. The heading is taken as in the
      file, without the highest and the lowest hundredth, which may be damaged.
    * Wheels that roll 10 times as far as the robot moves and turns, from second to second, slip by nine
      tenths, or are not in radians: degrees are 57 times, a way in millimetres 25.

    Args:
        where: the file, for messages.
        angle: (n, 4) wheel angles.
        steering: (k, 4) steering angles as they were read, before rows are completed.
        truth_t_s: (m,) times of the ground truth, s.
        pose: (m, 3) ground truth, heading unwrapped.
        heading: (m,) heading as in the file.
        nominal: robot that bounds the motion.

    Raises:
        DataError: a unit cannot be right.
    """
    if _in_degree_counts(steering):
        raise UnitError(
            where,
            "steering angles (delta) seem to be in degrees: all are multiples of a 4096th of 360",
            {"delta": np.pi / 180.0},
            expected="rad",
            remedy="multiply delta by 0.0174533",
        )
    way_m = rolled_m(angle, nominal.radius_m)
    span_m = np.ptp(pose[:, :2], axis=0)
    if np.max(span_m) > _FURTHER * way_m + _FURTHER_M:
        names = " and ".join(
            n for n, m in zip("xy", span_m, strict=True) if m > _FURTHER * way_m + _FURTHER_M
        )
        raise DataError(
            where,
            f"the robot moved {np.max(span_m):.3g} by ground truth ({names}) while its wheels rolled "
            f"{way_m:.3g} m",
            expected="x and y in m",
            remedy=f"convert {names} to metres: from millimetres by 0.001, from inches by 0.0254",
        )
    lever = lever_m(nominal.geometry)
    turned = float(np.ptp(np.percentile(heading, (1.0, 99.0))))
    if turned > _TURNS_MORE * way_m / lever + _WRAPPED_RAD:
        raise UnitError(
            where,
            f"the heading (theta) turns by {turned:.3g} while the wheels rolled {way_m:.3g} m, "
            f"enough for {way_m / lever:.3g} rad",
            {"theta": np.pi / 180.0},
            expected="radians",
            remedy="convert degrees to radians",
        )
    seen_m = _seen_m(truth_t_s, pose, lever)
    if seen_m > 0 and way_m > _ROLLS_MORE * seen_m + _ROLLS_M:
        raise DataError(
            where,
            f"wheels (phi) rolled {way_m:.3g} m but ground truth moved {seen_m:.3g} m",
            expected="positions in m and wheel angles in rad, of the same drive",
            remedy="no unit and no single column explains that: look whether all are of this robot and drive",
        )


def _in_degree_counts(steering: Array) -> bool:
    """Whether steering angles (n, 4) move by whole counts of 4096 a turn in degrees, by three or more.

    Servos of this kind measure multiples of 0.00153 rad. Of those, in radians, one in 57 would be such a
    number.
    """
    counts = (steering - steering[0]) / _COUNT_DEG
    whole = np.round(counts)
    distinct = max(len(np.unique(column)) for column in whole.T)
    return distinct > _COUNTS and bool(np.max(np.abs(counts - whole)) < _COUNT_OFF)


def rolled_m(angle: Array, radius_m: float) -> float:
    """Way that wheels with angles (n, 4) rolled, mean of the four wheels, m."""
    return float(np.abs(np.diff(angle, axis=0)).sum(axis=0).mean()) * radius_m


def _seen_m(t_s: Array, pose: Array, lever: float) -> float:
    """Way of a wheel by ground truth (m, 3), m; from rows a second apart, so that noise adds little."""
    stride = np.floor((t_s - t_s[0]) / _STRIDE_S)
    ends = np.append(np.flatnonzero(np.diff(stride, prepend=-1.0)), len(t_s) - 1)
    x, y, theta = np.diff(pose[ends], axis=0).T
    return float(np.sum(np.hypot(x, y) + lever * np.abs(theta)))
