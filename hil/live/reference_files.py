"""References for the live loop: waypoints of a CSV file, or a script that makes a trajectory."""

import csv
import io
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from hil.core.errors import DataError, UsageError, reason_of
from hil.core.geometry import Array
from hil.core.third_party_errors import of_a_script
from hil.robot.trajectories import Trajectory, through
from hil.support.file_reading import read_text
from hil.user_code.script_file import run_file

MOST_WAYPOINTS = 10_000
_MOST_BYTES = 16 << 20
_FARTHEST = 1000.0
"""Largest size of a coordinate, m or rad: beyond the longest motion."""
_SAME = 1e-6
"""Waypoints that differ by less, m and rad, count as equal."""


def read_waypoints(path: Path) -> list[Array]:
    """Poses, (3,) each, of a CSV file with the header `x,y,theta` (m, m, rad).

    Raises:
        DataError: it cannot be read, is no such list, or holds fewer than two poses or more than 10 000, one
            that is too far away, or the same twice in a row.
    """
    try:
        text = read_text(path, _MOST_BYTES)
    except (OSError, ValueError) as error:
        raise DataError(str(path), f"cannot be read ({reason_of(error)})") from None
    try:
        rows = csv.DictReader(io.StringIO(text, newline=""))
        found = [
            (rows.line_num, [float(row[k]) for k in ("x", "y", "theta")])
            for row in islice(rows, MOST_WAYPOINTS + 1)
        ]
    except (KeyError, TypeError, ValueError, csv.Error):
        raise DataError(str(path), "is no waypoint list", expected="header x,y,theta and numbers") from None
    _check(path, found)
    return [np.array(pose) for _, pose in found]


def _check(path: Path, found: list[tuple[int, list[float]]]) -> None:
    """Refuse waypoints that cannot be driven through; the error names the line of the file."""
    if len(found) > MOST_WAYPOINTS:
        raise DataError(
            str(path),
            f"holds more than {MOST_WAYPOINTS} waypoints",
            expected=f"at most {MOST_WAYPOINTS}",
            remedy="leave out points on straight lines, or divide the motion",
        )
    before: list[float] = []
    for line_number, pose in found:
        if not all(abs(value) <= _FARTHEST for value in pose):
            raise DataError(
                str(path),
                f"line {line_number} holds {', '.join(f'{value:g}' for value in pose)}",
                expected=f"finite numbers from {-_FARTHEST:g} to {_FARTHEST:g}",
            )
        if before and all(abs(a - b) < _SAME for a, b in zip(pose, before, strict=True)):
            raise DataError(
                str(path),
                f"line {line_number} repeats the waypoint before it",
                expected="waypoints that differ",
                remedy="leave it out",
            )
        before = pose
    if len(found) < 2:
        raise DataError(str(path), f"holds {len(found)} waypoint(s)", expected="at least 2")


MakeTrajectory = Callable[[Array], Trajectory]

_THERE_M, _THERE_RAD = 0.005, 0.01


def load_trajectory(
    path: Path, check: Callable[[Trajectory], None]
) -> tuple[MakeTrajectory, Trajectory | None]:
    """Load a function that makes the trajectory from the robot's pose (3,), and the part already checked.

    The path from the first waypoint on does not depend on that pose, so it is checked here.

    Args:
        path: `.csv` with the header `x,y,theta` (wall frame; the robot first drives straight to the
            first waypoint), or `.py` that defines `trajectory(start_pose)` and returns a `Trajectory`.
        check: function that refuses what the robot cannot follow, as `BenchModel.check` does.

    Returns:
        The function, and the checked path with whose segments its trajectories end; None for a script.

    Raises:
        ConfigError: a script that cannot be loaded.
        DataError: the file holds no usable waypoints.
        TrajectoryError: the robot cannot drive through them.
        UsageError: another kind of file, or a script that cannot be used.
    """
    if path.suffix == ".csv":
        waypoints = read_waypoints(path)
        way = through(waypoints, name=str(path))
        check(way)
        return lambda pose: _from_here(pose, waypoints, way, path.stem), way
    if path.suffix == ".py" and path.is_file():
        return _script(path), None
    raise UsageError(f"--trajectory {path}", expected="a .csv file of waypoints or a .py script")


def _from_here(pose: Array, waypoints: list[Array], way: Trajectory, name: str) -> Trajectory:
    """The path after a line to its first waypoint, or to its second if the robot is at the first."""
    gap = waypoints[0] - pose
    reached = int(np.hypot(gap[0], gap[1]) < _THERE_M and abs(gap[2]) < _THERE_RAD)
    first = through([pose, waypoints[reached]])
    return Trajectory(name, (*first.segments, *way.segments[reached:]))


def _script(path: Path) -> MakeTrajectory:
    module = run_file(path)
    make: Any = getattr(module, "trajectory", None)
    if not callable(make):
        raise UsageError(f"--trajectory {path}", expected="a function trajectory(start_pose)")

    def checked(pose: Array) -> Trajectory:
        with of_a_script(f"--trajectory {path}: trajectory()"):
            made = make(pose)
        if not isinstance(made, Trajectory):
            raise UsageError(
                f"--trajectory {path}: trajectory() returned {type(made).__name__}",
                expected="a hil.robot.trajectories.Trajectory",
            )
        return made

    return checked
