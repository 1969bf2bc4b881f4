"""`Recording`: wheel log and ground truth of one run, checked and repaired, on one time axis.

Calibration and evaluation use this type for every source (public CSV pair, plain CSV, MCAP).
`build_recording` repairs what can be repaired, counts each repair, and refuses the rest.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.bag_sensors import SensorLog
from hil.datasets.cleaning import INTEGRATED, Log, count_gaps, recorded_rates
from hil.datasets.clock_leaps import without_leaps
from hil.datasets.clock_steps import in_words, split
from hil.datasets.column_units import check_steering_unit, check_ways
from hil.datasets.filled_rows import measured
from hil.datasets.nominal_robot import Nominal
from hil.datasets.rate_units import check_rates
from hil.datasets.repeated_samples import without_held
from hil.datasets.truth_columns import check_columns, rounding
from hil.datasets.truth_jumps import WheelMotion
from hil.datasets.unit_check import check_units, rolled_m
from hil.datasets.usable_rows import Rows, usable, usable_wheels, without_frozen, without_jumps
from hil.datasets.wheel_displacements import Drive
from hil.datasets.wheel_turns import check_steering, whole_turns, without_turns
from hil.datasets.wrong_units import all_at_once

_MIN_SHARED = 2
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
        truth_pose: (m, 3) m, m, rad unwrapped; m is 0 where a bag is read without ground truth.
        receive_s, truth_receive_s: receive stamps, kept for the paper's own preprocessing.
        repairs: counts of repairs by name.
        problems: parts of its file that could not be read.
        contradictions: motions of its ground truth that no robot can have made.
        notes: corrections of its ground truth, see `hil.datasets.truth_correction`.
        of_twist: True where a twist was recorded: the wheels are then four that roll as it says, on the
            places of `nominal`.
        coupling: turns (4) of the drive encoders per turn of the steering that were taken out; else empty.
        nominal: nominal robot that it was read for.
        sensors: samples of the IMU and the camera of another robot's bag.
        unused: topics of its bag that could be used and are not named.
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
    of_twist: bool = False
    coupling: tuple[float, ...] = ()
    nominal: Nominal = field(default_factory=Nominal)
    sensors: SensorLog = field(default_factory=SensorLog)
    unused: tuple[str, ...] = ()
    later: tuple[Recording, ...] = ()
    derived: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def has_rates(self) -> bool:
        """Whether the velocity register was recorded for all rows."""
        return bool(np.all(np.isfinite(self.wheel_rate_rad_s)))

    @property
    def has_truth(self) -> bool:
        """Whether there is ground truth."""
        return len(self.truth_t_s) > 0

    def contradicted(self, *said: str) -> Recording:
        """A copy with further contradictions, in words."""
        return replace(self, contradictions=(*self.contradictions, *said))

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
    truth: Log | None,
    *,
    motion: str = "",
    sources: tuple[str, ...] = (),
    sha256: tuple[str, ...] = (),
    nominal: Nominal | None = None,
    repairs: Mapping[str, int] | None = None,
    of_twist: bool = False,
    with_sensors: bool = False,
) -> Recording:
    """Repair and check the two logs of a run; split it where stamps step back (`Recording.later`).

    Args:
        name: name of the recording, also in messages.
        wheels: columns phi_1..4, delta_1..4 and, optionally, wheel rates 1..4.
        truth: columns x, y, theta (theta may be wrapped); None to replay the wheels without it.
        motion: group name; classified from the ground truth when empty.
        sources: files it was read from.
        sha256: digests of those files, in the same order.
        nominal: nominal robot for the checks of units and motion, the CAD model by default.
        repairs: counts of repairs made by the reader, by name.
        of_twist: True for wheels that were made of a twist: units and angles of wheels are not checked.
        with_sensors: True where sensors are read from the same clock: its leaps are then not taken out.

    Raises:
        DataError: too short, no ground truth, no overlap in time, wrong units, or wheel angles that leap
            or whose number of turns is unknown.
    """
    where, robot = sources[0] if sources else name, nominal if nominal is not None else Nominal()

    def build(called: str, wheels: Log, truth: Log | None) -> Recording:
        whole = partial(_build, with_sensors=with_sensors)
        how = _without_truth if truth is None else partial(whole, truth=truth)
        return how(called, where, wheels, motion, robot, dict(repairs or {}), of_twist)

    parts, problems, refusals = list[Recording](), list[str](), list[DataError]()
    logs = [
        (one, None if truth is None else other)
        for one, other in split(where, wheels, wheels if truth is None else truth)
    ]
    for k, (own_wheels, own_truth) in enumerate(logs, start=1):
        called = name if len(logs) == 1 else f"{name} part {k}"
        try:
            parts.append(all_at_once(where, own_wheels, own_truth, partial(build, called)))
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
    name: str,
    where: str,
    wheels: Log,
    motion: str,
    robot: Nominal,
    repairs: dict[str, int],
    of_twist: bool,
    *,
    truth: Log,
    with_sensors: bool,
) -> Recording:
    """One recording from logs without steps back; see `build_recording`."""
    rows, poses = usable(where, wheels, truth, repairs)
    if not with_sensors:
        rows, poses = without_leaps(rows, poses, repairs)
    begin_s, end_s = max(rows.t_s[0], poses.t_s[0]), min(rows.t_s[-1], poses.t_s[-1])
    counted = rows.values[:, 4:8]
    fresh, values = without_held(rows.t_s, rows.values, repairs)
    rows = Rows(rows.t_s, values, rows.receive_s).only(fresh)
    rate = recorded_rates(rows.values, repairs)
    turns = whole_turns(where, rows.t_s, rows.values[:, :4], rate)
    repairs.update(turns.repairs)
    _check_rounding(where, Drive(rows.t_s, turns.angle, rows.values[:, 4:8], poses.t_s, poses.values), robot)
    poses = without_frozen(where, poses, rows.t_s, turns.angle, end_s, repairs)
    poses = poses.only(measured(poses.t_s, poses.values, repairs))
    raw, steering = rows.values[:, 4:8], without_turns(rows.values[:, 4:8])
    by_wheels = WheelMotion.of(rows.t_s, turns.angle, steering, robot)
    poses, lasting = without_jumps(where, poses, by_wheels, repairs)
    count_gaps(repairs, rows.t_s, "wheel gaps over {:g} s bridged")
    count_gaps(repairs, poses.t_s, "ground-truth gaps over {:g} s, in which nothing is compared")
    as_read = Drive(rows.t_s, rows.values[:, :4], steering, poses.t_s, poses.values)
    pose = np.column_stack([poses.values[:, :2], np.unwrap(poses.values[:, 2])])
    unwrapped = replace(as_read, angle=turns.angle, pose=pose)
    shared = (begin_s, end_s)
    _check_shared(where, unwrapped, shared)
    if not of_twist:
        _check(
            where,
            as_read,
            unwrapped,
            shared,
            (counted, raw, rate),
            turns.refusal,
            robot,
            INTEGRATED in repairs,
        )
    return Recording(
        name=name,
        motion=motion or classify(turns.angle, pose, robot.radius_m),
        t_s=rows.t_s,
        wheel_angle_rad=turns.angle,
        steering_rad=steering,
        wheel_rate_rad_s=rate,
        truth_t_s=poses.t_s,
        truth_pose=pose,
        receive_s=rows.receive_s,
        truth_receive_s=poses.receive_s,
        repairs=repairs,
        contradictions=lasting,
        nominal=robot,
        of_twist=of_twist,
    )


def _without_truth(
    name: str, where: str, wheels: Log, motion: str, robot: Nominal, repairs: dict[str, int], of_twist: bool
) -> Recording:
    """The same from a wheel log alone, of which only what wheels can show of themselves is checked."""
    rows = usable_wheels(where, wheels, repairs)
    fresh, values = without_held(rows.t_s, rows.values, repairs)
    rows = Rows(rows.t_s, values, rows.receive_s).only(fresh)
    rate = recorded_rates(rows.values, repairs)
    turns = whole_turns(where, rows.t_s, rows.values[:, :4], rate)
    repairs.update(turns.repairs)
    count_gaps(repairs, rows.t_s, "wheel gaps over {:g} s bridged")
    steering, none = without_turns(rows.values[:, 4:8]), np.empty(0)
    if not of_twist:
        if turns.refusal is not None:
            raise turns.refusal
        check_steering(where, rows.t_s, steering, turns.angle)
        check_rates(where, rows.t_s, turns.angle, rate)
    return Recording(
        name=name,
        motion=motion or "other",
        t_s=rows.t_s,
        wheel_angle_rad=turns.angle,
        steering_rad=steering,
        wheel_rate_rad_s=rate,
        truth_t_s=none,
        truth_pose=np.empty((0, 3)),
        receive_s=rows.receive_s,
        truth_receive_s=none,
        repairs=repairs,
        nominal=robot,
        of_twist=of_twist,
    )


def _check_rounding(where: str, drive: Drive, robot: Nominal) -> None:
    """Raise `DataError` for ground truth that is rounded, unless it is in another unit."""
    if coarse := rounding(drive.pose):
        check_ways(where, drive, robot, integrated=False)
        heading = drive.pose[:, 2]
        check_units(where, drive.angle, drive.steering, drive.truth_t_s, drive.pose, heading, robot)
        raise DataError(
            where,
            f"its ground truth is rounded: {coarse}",
            expected="positions to 1 mm and headings to 0.1 deg, or better",
            remedy="export the poses with all their digits",
        )


def _check_shared(where: str, drive: Drive, between_s: tuple[float, float]) -> None:
    """Raise `DataError` where wheels or ground truth have no rows in the time that they share."""
    for t_s in (drive.t_s, drive.truth_t_s):
        if np.count_nonzero((t_s >= between_s[0]) & (t_s <= between_s[1])) < _MIN_SHARED:
            raise DataError(
                where, "wheels and ground truth have no rows in the time they share", expected="rows of both"
            )


def _check(
    where: str,
    as_read: Drive,
    drive: Drive,
    between_s: tuple[float, float],
    measured: tuple[Array, Array, Array],
    refusal: DataError | None,
    robot: Nominal,
    integrated: bool,
) -> None:
    """Raise `DataError` for units and angles that cannot be right.

    Args:
        where: the file, for messages.
        as_read: rows with wheel angles and headings as in the file.
        drive: the same rows with whole turns undone.
        between_s: begin and end of the time that wheels and ground truth share.
        measured: steering angles of all rows and of those used, both as in the file, and wheel rates.
        refusal: error about the wheel angles; raised unless a unit explains it.
        robot: nominal robot.
        integrated: True where the wheel angles were integrated from wheel rates.
    """
    counted, raw, rate = measured
    shared, seen = ((t >= between_s[0]) & (t <= between_s[1]) for t in (drive.t_s, drive.truth_t_s))
    check_ways(where, as_read, robot, integrated=integrated)
    if refusal is not None:
        raise refusal
    check_columns(where, drive, robot)
    pose, heading = drive.pose[seen], as_read.pose[seen, 2]
    check_units(where, drive.angle[shared], counted, drive.truth_t_s[seen], pose, heading, robot)
    check_steering_unit(where, drive, raw, robot)
    check_steering(where, drive.t_s, drive.steering, drive.angle)
    check_rates(where, drive.t_s, drive.angle, rate)


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
