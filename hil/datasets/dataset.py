"""`Recording`: wheel log and ground truth of one run, checked and repaired, on one time axis.

Calibration and evaluation use this type for every source (public CSV pair, plain CSV, MCAP).
`build_recording` repairs what can be repaired, counts each repair, and refuses the rest.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array, Bools
from hil.datasets.cleaning import Log, clean, count, count_gaps, emptiest, recorded_rates, with_angles
from hil.datasets.held_rows import without_held
from hil.datasets.nominal_robot import Nominal
from hil.datasets.partial_rows import completed
from hil.datasets.segments import in_words, split
from hil.datasets.truth_jumps import WheelMotion, find_jumps
from hil.datasets.unit_check import check_repeats, check_stamp_jumps, check_time, check_units, rolled_m
from hil.datasets.unit_factors import check_rates, check_steering_unit, check_ways
from hil.datasets.wheel_turns import check_steering, whole_turns, without_turns
from hil.datasets.wheel_ways import Drive

FROZEN = "ground-truth rows that repeat an earlier pose while the wheels roll (a frozen source) left out"
_ROLLED_RAD, _LITTLE_RAD = 0.08, 0.02


def fresh_rows(truth_t_s: Array, pose: Array, t_s: Array, angle: Array) -> Bools:
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


_MIN_ROWS = 20
_FROZEN_S = 0.5
_WHEEL_COLUMNS = ("t", *(f"phi{i}" for i in range(1, 5)), *(f"delta{i}" for i in range(1, 5)))
_TRUTH_COLUMNS = ("t", "x", "y", "theta")
_MIN_SHARED = 2
_SPANS = ((3.15576e7, "years"), (86400.0, "days"), (3600.0, "hours"), (1.0, "s"))
_ROTATION_RAD = 5.0
_ROTATION_PATH_M = 0.3


@dataclass(frozen=True)
class Recording:
    """One run of the robot; wheel order FL, BL, BR, FR.

    Attributes:
        name: file or run name; `motion` groups repetitions; `sources` and `sha256` are its files.
        t_s: (n,) strictly increasing, s; `truth_t_s` (m,) has the same time axis.
        wheel_angle_rad: (n, 4) cumulative; `steering_rad` (n, 4) without leaps by whole turns.
        wheel_rate_rad_s: (n, 4) velocity register, NaN where the source has none.
        truth_pose: (m, 3) m, m, rad unwrapped.
        receive_s, truth_receive_s: receive stamps, kept for the paper's own preprocessing.
        repairs: counts of repairs by name.
        problems: parts of its file that could not be read.
        contradictions: what of its ground truth no robot can have done.
        notes: corrections of its ground truth, see `hil.datasets.truth_correction`.
        coupling: turns (4) of the drive encoders per turn of the steering that were taken out; else empty.
        nominal: nominal robot that it was read for.
        later: parts after each step back of the stamps, as recordings of their own.
        derived: cache of results computed from the recording alone; empty in copies made by `replace`.
    """

    name: str
    motion: str
    t_s: Array
    wheel_angle_rad: Array
    steering_rad: Array
    wheel_rate_rad_s: Array
    truth_t_s: Array
    truth_pose: Array
    receive_s: Array
    truth_receive_s: Array
    sources: tuple[str, ...] = ()
    sha256: tuple[str, ...] = ()
    repairs: Mapping[str, int] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    coupling: tuple[float, ...] = ()
    nominal: Nominal = field(default_factory=Nominal)
    later: tuple[Recording, ...] = ()
    derived: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def has_rates(self) -> bool:
        """Whether the velocity register was recorded for all rows."""
        return bool(np.all(np.isfinite(self.wheel_rate_rad_s)))

    def warnings(self) -> tuple[str, ...]:
        """Losses and repairs, one line each."""
        of = f"its figures are of {self.t_s[-1] - self.t_s[0]:.1f} s that were read"
        return (
            *(f"{self.name}: {what}; {of}" for what in self.problems),
            *(f"{self.name}: {count} {what}" for what, count in sorted(self.repairs.items())),
        )


def build_recording(
    name: str,
    wheels: Log,
    truth: Log,
    *,
    motion: str = "",
    sources: tuple[str, ...] = (),
    sha256: tuple[str, ...] = (),
    nominal: Nominal | None = None,
    repairs: Mapping[str, int] | None = None,
) -> Recording:
    """Repair and check the two logs of a run; split it where stamps step back (`Recording.later`).

    Args:
        name: name of the recording, also in messages.
        wheels: columns phi_1..4, delta_1..4 and, optionally, wheel rates 1..4.
        truth: columns x, y, theta (theta may be wrapped).
        motion: group name; classified from the ground truth when empty.
        sources: files it was read from.
        sha256: digests of those files, in the same order.
        nominal: nominal robot for the checks of units and motion, the CAD model by default.
        repairs: counts of repairs made by the reader, by name.

    Raises:
        DataError: too short, no ground truth, no overlap in time, wrong units, or wheel angles that leap
            or whose number of turns is unknown.
    """
    where, robot = sources[0] if sources else name, nominal if nominal is not None else Nominal()
    parts, problems, refusals = list[Recording](), list[str](), list[DataError]()
    logs = split(where, wheels, truth)
    for k, (own_wheels, own_truth) in enumerate(logs, start=1):
        called = name if len(logs) == 1 else f"{name} part {k}"
        try:
            parts.append(_build(called, where, own_wheels, own_truth, motion, robot, dict(repairs or {})))
        except DataError as error:
            refusals.append(error)
            problems.append(f"part {k} of it is left out ({error.message.removeprefix(f'{where}: ')})")
    if not parts:
        raise refusals[0]
    parts = [replace(part, sources=sources, sha256=sha256) for part in parts]
    if len(logs) == 1:
        return parts[0]
    reported = {**parts[0].repairs, in_words(wheels): len(logs) - 1}
    return replace(parts[0], repairs=reported, problems=tuple(problems), later=tuple(parts[1:]))


def _build(
    name: str, where: str, wheels: Log, truth: Log, motion: str, robot: Nominal, repairs: dict[str, int]
) -> Recording:
    """One recording from logs without steps back; see `build_recording`."""
    check_time(where, wheels.t_s)
    for kind, log in (("wheel", wheels), ("ground-truth", truth)):
        check_repeats(where, kind, log.t_s, log.values)
    wheels = completed(with_angles(wheels, repairs), 8, "wheel", range(4, 8), repairs)
    t_s, w, receive_s = clean(wheels, 8, "wheel", repairs)
    truth = completed(truth, 3, "ground-truth", (2,), repairs)
    truth_t_s, pose, truth_receive_s = clean(truth, 3, "ground-truth", repairs)
    if len(t_s) < _MIN_ROWS:
        raise DataError(
            where,
            f"only {len(t_s)} usable wheel rows{emptiest(wheels, _WHEEL_COLUMNS)}",
            expected=f"at least {_MIN_ROWS}",
        )
    if len(truth_t_s) < _MIN_ROWS:
        raise DataError(
            where,
            f"only {len(truth_t_s)} usable ground-truth rows{emptiest(truth, _TRUTH_COLUMNS)}",
            expected="x, y and theta from motion capture",
            remedy="a run without ground truth can be replayed but not evaluated or calibrated",
        )
    begin_s, end_s = max(t_s[0], truth_t_s[0]), min(t_s[-1], truth_t_s[-1])
    if end_s - begin_s < 1.0:
        raise _apart(where, float(truth_t_s[0] - t_s[0]), float(end_s - begin_s))
    for stamps in (t_s, truth_t_s):
        check_stamp_jumps(where, stamps)
    counted = w[:, 4:8]
    fresh, w = without_held(t_s, w, repairs)
    t_s, w, receive_s = t_s[fresh], w[fresh], receive_s[fresh]
    rate = recorded_rates(w, repairs)
    turns = whole_turns(where, t_s, w[:, :4], rate)
    angle = turns.angle
    repairs.update(turns.repairs)
    fresh = fresh_rows(truth_t_s, pose, t_s, angle)
    truth_t_s, pose, truth_receive_s = truth_t_s[fresh], pose[fresh], truth_receive_s[fresh]
    frozen_s = end_s - truth_t_s[-1]
    count(repairs, FROZEN, np.count_nonzero(~fresh))
    if len(truth_t_s) < _MIN_ROWS or frozen_s > _FROZEN_S:
        raise DataError(
            where,
            f"the ground truth repeats its last pose for {frozen_s:.1f} s while the wheels roll",
            expected="a source that goes on to the end",
            remedy="look at what the capture system sent",
        )
    raw, steering = w[:, 4:8], without_turns(w[:, 4:8])
    by_wheels = WheelMotion.of(t_s, angle, steering, robot)
    keep, lasting = _without_jumps(where, truth_t_s, pose, by_wheels, repairs)
    truth_t_s, pose, truth_receive_s = truth_t_s[keep], pose[keep], truth_receive_s[keep]
    count_gaps(repairs, t_s, "wheel gaps over {:g} s bridged")
    count_gaps(repairs, truth_t_s, "ground-truth gaps over {:g} s, in which nothing is compared")
    heading = pose[:, 2]
    pose = np.column_stack([pose[:, :2], np.unwrap(heading)])
    shared, truth_shared = ((t >= begin_s) & (t <= end_s) for t in (t_s, truth_t_s))
    if min(np.count_nonzero(shared), np.count_nonzero(truth_shared)) < _MIN_SHARED:
        raise DataError(
            where, "wheels and ground truth have no rows in the time they share", expected="rows of both"
        )
    as_read = np.column_stack([pose[:, :2], heading])
    check_ways(where, Drive(t_s, w[:, :4], steering, truth_t_s, as_read), robot)
    if turns.refusal is not None:
        raise turns.refusal
    check_units(
        where,
        angle[shared],
        counted,
        truth_t_s[truth_shared],
        pose[truth_shared],
        heading[truth_shared],
        robot,
    )
    check_steering_unit(where, Drive(t_s, angle, steering, truth_t_s, pose), raw, robot)
    check_steering(where, t_s, steering, angle)
    check_rates(where, t_s, angle, rate)
    return Recording(
        name=name,
        motion=motion or classify(angle, pose, robot.radius_m),
        t_s=t_s,
        wheel_angle_rad=angle,
        steering_rad=steering,
        wheel_rate_rad_s=rate,
        truth_t_s=truth_t_s,
        truth_pose=pose,
        receive_s=receive_s,
        truth_receive_s=truth_receive_s,
        repairs=repairs,
        contradictions=lasting,
        nominal=robot,
    )


def _apart(where: str, later_s: float, shared_s: float) -> DataError:
    """Error of logs that share less than a second, with the time between their first rows."""
    size, unit = next((size, unit) for size, unit in _SPANS if abs(later_s) >= size or size == 1.0)
    word = "after" if later_s > 0 else "before"
    return DataError(
        where,
        f"wheels and ground truth share {max(shared_s, 0.0):.2f} s: the ground truth begins "
        f"{abs(later_s):.3f} s ({abs(later_s) / size:.3g} {unit}) {word} the wheels",
        expected="stamps of one clock, >= 1 s of both",
        remedy=f"if both began together, subtract {later_s:.3f} s from the stamps of the ground truth; else "
        "stamp both by the computer that records them",
    )


def _without_jumps(
    where: str, t_s: Array, pose: Array, wheels: WheelMotion, repairs: dict[str, int]
) -> tuple[Bools, tuple[str, ...]]:
    """Mask of ground-truth rows (m,) to keep, and the first jump that lasts, in words.

    Raises:
        DataError: the mask is of less than half of the rows.
    """
    found = find_jumps(t_s, pose, wheels)
    dropped = np.count_nonzero(~found.keep) - found.resting
    if 2 * dropped > len(t_s):
        raise DataError(
            where,
            f"the ground truth (x, y, theta) leaps: {dropped} of {len(t_s)} rows are out of reach",
            expected="a path that the robot can have driven",
            remedy="look at what the capture system tracked",
        )
    count(repairs, "ground-truth rows that leap away and back dropped", dropped)
    count(repairs, "ground-truth rows beyond a leap, in which the robot rests, dropped", found.resting)
    more = f" (the first of {len(found.lasting)} such steps)" if len(found.lasting) > 1 else ""
    return found.keep, tuple(jump.in_words() + more for jump in found.lasting[:1])


def classify(angle: Array, pose: Array, radius_m: float) -> str:
    """Motion name by wheels and ground truth: one of the paper's six, or `other`.

    Args:
        angle: (n, 4) cumulative wheel angles, rad.
        pose: (m, 3) ground truth, m, m, rad unwrapped.
        radius_m: radius of the wheels.
    """
    turn = float(pose[-1, 2] - pose[0, 2])
    path_m = rolled_m(angle, radius_m)
    sense = "ccw" if turn > 0 else "cw"
    if abs(turn) > _ROTATION_RAD:
        span_m = float(np.max(np.ptp(pose[:, :2], axis=0)))
        return f"rotation_{sense}" if span_m < _ROTATION_PATH_M else f"circle_{sense}"
    c, s = np.cos(pose[0, 2]), np.sin(pose[0, 2])
    moved = pose[-1, :2] - pose[0, :2]
    ahead, left = abs(c * moved[0] + s * moved[1]), abs(-s * moved[0] + c * moved[1])
    if abs(turn) < 1.0 and max(ahead, left) > 0.5 * path_m > 0.05:
        return "line_x" if ahead > left else "line_y"
    return "other"
