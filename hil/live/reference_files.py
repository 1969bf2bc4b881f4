"""References for the live loop: waypoints of a CSV file, or a script that makes a trajectory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hil.core.errors import UsageError
from hil.core.geometry import Array
from hil.core.package_errors import of_a_script
from hil.robot.trajectories import Trajectory, through
from hil.robot.waypoints import read_waypoints
from hil.support.script_file import run_file

MakeTrajectory = Callable[[Array], Trajectory]

_THERE_M, _THERE_RAD = 0.005, 0.01


def load_trajectory(
    path: Path, check: Callable[[Trajectory], None]
) -> tuple[MakeTrajectory, Trajectory | None]:
    """How to make the reference from the pose (3,) where the robot stands, and what of it is known to hold.

    What can be checked before that is known is checked here: the way from the first waypoint on.

    Args:
        path: `.csv` with the header `x,y,theta` (wall frame; the robot first drives straight to the
            first waypoint), or `.py` that defines `trajectory(start_pose)` and returns a `Trajectory`.
        check: refuses what the robot cannot follow, as `Blueprint.check` does.

    Returns:
        The maker, and the way with whose segments its trajectories end, checked; None for a script.

    Raises:
        ConfigError: a script that cannot be loaded.
        DataError: no such waypoints.
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
    """The way after a line to its first waypoint, or to its second where the robot is at the first."""
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
