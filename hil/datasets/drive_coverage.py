"""Checks that wheels and ground truth cover the same drive.

Odometry is evaluated where both exist. A truncated file, or a capture system that ended early, leaves part of
the drive out of all errors, and makes the error at the end meaningless. A rest covered by only one of them
does not matter.
"""

from dataclasses import dataclass, replace

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.nominal_robot import Nominal, lever_m
from hil.datasets.unit_check import rolled_m
from hil.datasets.wheel_log import Recording

_BRIEF_S = 0.5
_WORTH_M = 0.01
_MOST_M, _MOST_SHARE = 0.02, 0.02
_REST_S, _REST_M = 0.5, 2e-3
_EDGE_ROWS = 5
_MOST_ROWS = 98.0
"""Percentile used in place of the maximum, so that single wrong rows do not count."""


@dataclass(frozen=True)
class Unseen:
    """A span of time in which one log moves and the other has no rows.

    Attributes:
        by: log without rows, `wheels` or `ground truth`.
        after: True if the span is after the last row of that log, else before its first.
        lasts_s: duration, s.
        moved_m: largest distance of the other log from the edge, turns at the distance of the wheels, m.
        under_way: True if the wheels roll next to the span, where both logs have rows.
    """

    by: str
    after: bool
    lasts_s: float
    moved_m: float
    under_way: bool

    def in_words(self) -> str:
        """Description of the motion and its time, for a message."""
        other = "ground truth moves" if self.by == "wheels" else "wheels roll"
        when = "after the last" if self.after else "before the first"
        return f"the {other} {self.moved_m:.2f} m in the {self.lasts_s:.1f} s {when} row of the {self.by}"


def covered(recording: Recording, nominal: Nominal) -> Recording:
    """The recording, with a repair entry for each span of motion in only one of the logs.

    Args:
        recording: recording to check.
        nominal: robot that it is read for.

    Raises:
        DataError: one log lacks more than 2 % of the way, and 20 mm, and this part is the end of the wheels'
            drive, continues the covered part without a stop, or is longer than the covered part.
    """
    found = unseen(recording, nominal)
    if not found:
        return recording
    seen_m, whole_m = _rolled_m(recording, nominal)
    for one in found:
        if one.moved_m > max(_MOST_M, _MOST_SHARE * whole_m) and (
            one.under_way or (one.after and one.by == "ground truth") or one.moved_m > seen_m
        ):
            raise _refusal(recording, one)
    reported = {f"stretch of the drive not checked: {one.in_words()}": 1 for one in found}
    return replace(recording, repairs={**recording.repairs, **reported})


def unseen(recording: Recording, nominal: Nominal) -> list[Unseen]:
    """Spans over half a second in which only wheels or only ground truth moved by more than 10 mm.

    Args:
        recording: recording to check.
        nominal: robot that it is read for.
    """
    wheel_s, truth_s = recording.t_s, recording.truth_t_s
    begin_s, end_s = max(wheel_s[0], truth_s[0]), min(wheel_s[-1], truth_s[-1])
    rolled = recording.wheel_angle_rad * nominal.radius_m
    lever = lever_m(nominal.geometry)
    out = []
    for after, edge_s in ((False, begin_s), (True, end_s)):
        near = (wheel_s >= edge_s - _REST_S) & (wheel_s <= edge_s + _REST_S)
        near &= (wheel_s >= begin_s) & (wheel_s <= end_s)
        under_way = bool(near.any() and np.max(np.ptp(rolled[near], axis=0)) > _REST_M)
        for by, t_s in (("ground truth", wheel_s), ("wheels", truth_s)):
            outside = np.flatnonzero(t_s > edge_s if after else t_s < edge_s)
            lasts_s = abs(float((t_s[-1] if after else t_s[0]) - edge_s))
            if not len(outside) or lasts_s < _BRIEF_S:
                continue
            outside = outside if after else outside[::-1]
            moved_m = (
                _furthest(np.max(np.abs(_from_edge(rolled[outside])), axis=1))
                if by == "ground truth"
                else _furthest(_apart_m(_from_edge(recording.truth_pose[outside]), lever))
            )
            if moved_m > _WORTH_M:
                out.append(Unseen(by, after, lasts_s, moved_m, under_way))
    return out


def _from_edge(rows: Array) -> Array:
    """Rows (n, k), ordered from the edge on, less the median of the first five."""
    return np.asarray(rows - np.median(rows[:_EDGE_ROWS], axis=0), dtype=np.float64)


def _apart_m(pose: Array, lever: float) -> Array:
    """Lengths (n,) of moves (n, 3), m, with turns at the distance `lever`."""
    return np.asarray(np.hypot(pose[:, 0], pose[:, 1]) + lever * np.abs(pose[:, 2]), dtype=np.float64)


def _furthest(ways_m: Array) -> float:
    return float(np.percentile(ways_m, _MOST_ROWS))


def _rolled_m(recording: Recording, nominal: Nominal) -> tuple[float, float]:
    """Way of the wheels during the ground truth, and in all, mean of the four wheels, m."""
    t_s, angle = recording.t_s, recording.wheel_angle_rad
    first = max(int(np.searchsorted(t_s, recording.truth_t_s[0])) - 1, 0)
    behind = int(np.searchsorted(t_s, recording.truth_t_s[-1], side="right")) + 1
    return rolled_m(angle[first:behind], nominal.radius_m), rolled_m(angle, nominal.radius_m)


def _refusal(recording: Recording, one: Unseen) -> DataError:
    files = recording.sources or (recording.name,)
    wheels_s, truth_s = (t_s[-1] - t_s[0] for t_s in (recording.t_s, recording.truth_t_s))
    return DataError(
        files[0] if one.by == "wheels" else files[-1],
        f"the wheels cover {wheels_s:.1f} s, the ground truth {truth_s:.1f} s: {one.in_words()}, "
        "and no error would include that",
        expected="wheels and ground truth of the whole drive",
        remedy="copy or record it again; to use a part of it, cut both to the same time, best at rest",
    )
