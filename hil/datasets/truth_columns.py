"""Finds a column of ground truth that is rounded, or holds another quantity than its name says.

Rounded values are multiples of one step, and stay the same for most rows of a drive. The wheels predict every
column: the way in x and in y, and the turn. Where one of them does not follow while
the others do, it is named, and so is what it holds instead, if that can be seen.
"""

from dataclasses import replace

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.nominal_robot import Nominal, lever_m
from hil.datasets.wheel_displacements import Complexes, Drive, by_truth, by_wheels, missed, rolling
from hil.robot.kinematics import WheelGeometry

_WRONG, _AGREES = 0.6, 0.2
_COURSE, _MOST = 0.1, 0.8
_WORTH_M, _FEWEST = 0.1, 4
_COARSE, _STEPS, _OFF_STEP, _HELD = {"x": 2e-3, "y": 2e-3, "theta": 8e-3}, 5, 0.01, 0.5
"""Rounding that is too coarse, m and rad; what shows it."""


def rounding(pose: Array) -> str:
    """Columns of ground truth (m, 3) that are rounded to 2 mm, or 8 mrad, or more, in words; else empty.

    A robot that is simulated without noise may change by equal steps as well, but from row to row.
    """
    steps = {name: _step(column) for name, column in zip(_COARSE, pose.T, strict=True)}
    return ", ".join(
        f"theta to {step:.3g} rad ({np.degrees(step):.2g} deg)"
        if name == "theta"
        else f"{name} to {step:.3g} m"
        for name, step in steps.items()
        if step >= _COARSE[name]
    )


def _step(column: Array) -> float:
    """The step to multiples of which values (m,) are rounded; 0 where they are not."""
    values = np.unique(column)
    changes = np.flatnonzero(np.diff(column))
    if len(values) < _STEPS or len(changes) < _STEPS:
        return 0.0
    step = float(np.diff(values).min())
    multiples = np.abs(values / step - np.round(values / step)).max() < _OFF_STEP
    held = 1.0 - len(changes) / (changes[-1] - changes[0] + 1)
    return step if multiples and held > _HELD else 0.0


def check_columns(where: str, drive: Drive, nominal: Nominal) -> None:
    """Refuse a column of ground truth that does not follow the wheels while the other columns do.

    Most wheels miss 0.6 of their way as it is. The heading is named where it is the direction of travel and
    the positions agree with the wheels' own heading, or where it agrees exchanged with a steering
    angle (less than 0.2 is missed); x or y where the other one and the heading agree.

    Args:
        where: the file, for messages.
        drive: recording with unwrapped angles and heading.
        nominal: robot with the wheels.

    Raises:
        DataError: names the column.
    """
    edges_s, wheels = drive.edges_s(), nominal.geometry
    rolled, moved = by_wheels(drive, edges_s, wheels), by_truth(drive.truth_t_s, drive.pose, edges_s, wheels)
    mask = rolling(rolled, moved, drive.known(edges_s), wheels)
    if np.count_nonzero(mask) < _FEWEST or np.median(missed(rolled[mask], moved[mask])) < _WRONG:
        return
    said = _exchanged(drive, edges_s, wheels) or _of_positions(drive, edges_s, rolled, wheels)
    if said:
        raise DataError(
            where,
            f"{said}, while the other columns agree with the wheels",
            expected="x and y in the plane in which the robot drives, and its heading theta",
            remedy="look which columns were written into the file",
        )


def _exchanged(drive: Drive, edges_s: Array, wheels: WheelGeometry) -> str:
    """Names the steering angles that seem to be exchanged with the heading; else empty."""
    found = []
    for i in range(drive.steering.shape[1]):
        steering, pose = drive.steering.copy(), drive.pose.copy()
        steering[:, i] = np.interp(drive.t_s, drive.truth_t_s, drive.pose[:, 2])
        pose[:, 2] = np.interp(drive.truth_t_s, drive.t_s, drive.steering[:, i])
        other = replace(drive, steering=steering, pose=pose)
        rolled = by_wheels(other, edges_s, wheels)
        moved = by_truth(other.truth_t_s, pose, edges_s, wheels)
        mask = rolling(rolled, moved, other.known(edges_s), wheels)
        if np.count_nonzero(mask) >= _FEWEST and np.max(missed(rolled[mask], moved[mask])) < _AGREES:
            found.append(f"delta{i + 1}")
    return f"the heading (theta) and {' or '.join(found)} are exchanged" if found else ""


def _of_positions(drive: Drive, edges_s: Array, rolled: Complexes, wheels: WheelGeometry) -> str:
    """Names the one of x, y and theta that does not follow ways (s, 4) of the wheels; else empty."""
    place = wheels.x_m + 1j * wheels.y_m
    way = rolled.mean(axis=1)
    turn = np.sum((np.conj(place) * rolled).imag, axis=1) / float(np.sum(np.abs(place) ** 2))
    heading = np.cumsum(turn) - 0.5 * turn
    x, y, theta = (np.interp(edges_s, drive.truth_t_s, column) for column in drive.pose.T)
    went, turned = np.diff(x) + 1j * np.diff(y), np.diff(theta)
    by_own = way * np.exp(1j * heading)
    by_own *= np.exp(1j * np.angle(np.vdot(by_own, went)))
    if np.abs(went).sum() > _WORTH_M and _share(by_own, went) < _AGREES:
        course = np.abs(np.sin(0.5 * (theta[1:] + theta[:-1]) - np.angle(went)))
        goes = np.abs(went) > 0.5 * np.percentile(np.abs(went), 90.0)
        sideways = np.abs(np.sin(np.angle(way))) > _COURSE  # straight ahead or back the heading is the course
        is_course = np.mean((course < _COURSE)[goes]) > _MOST and np.mean(sideways[goes]) > _MOST
        return "the heading (theta) is the direction in which it moves" if is_course else ""
    lever, expected = lever_m(wheels), way * np.exp(0.5j * (theta[1:] + theta[:-1]))
    pairs = {"x": (expected.real, went.real), "y": (expected.imag, went.imag)}
    off = {name: float(np.abs(by - to).sum()) for name, (by, to) in pairs.items()}
    whole_m = float(np.abs(expected).sum())
    if lever * np.abs(turn - turned).sum() > _AGREES * (whole_m + lever * np.abs(turn).sum()):
        return ""
    for name, other in (("x", "y"), ("y", "x")):
        own_m = float(np.abs(pairs[name][0]).sum())
        by, to = pairs[name]
        scaled = _share(by * float(by @ to) / max(float(by @ by), 1e-9), to) < _AGREES
        if own_m > _WORTH_M and off[name] > _WRONG * own_m and off[other] < _AGREES * whole_m and not scaled:
            return (
                f"{name} does not follow the robot (a height, or another coordinate?): it changes by "
                f"{np.abs(pairs[name][1]).sum():.2g} m where the wheels go {own_m:.2g} m in {name}"
            )
    return ""


def _share(one: Array | Complexes, other: Array | Complexes) -> float:
    """Share of the larger way in which two differ."""
    size = max(float(np.abs(one).sum()), float(np.abs(other).sum()), 1e-9)
    return float(np.abs(one - other).sum()) / size
