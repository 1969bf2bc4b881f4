"""Finds small steps of ground truth: where one camera, or one part of a path, is joined to another.

Beside the motion of the wheels the path is a line in any half second, with a bend where the robot slips. A
step at one instant is none of these. It is measured over 0.8 s and over 0.24 s; the smaller one counts, which
a slip of a second does not reach. Starts and stops are left out: there a late clock looks like a step. So
are gaps, and poses that are held: behind them the path catches up.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hil.core.geometry import Array, Bools
from hil.datasets.sampling import interpolate, is_slow, wheel_steps
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import forward

_GRID_S, _WIDE, _NARROW = 0.02, 20, 6
_BESIDE, _USUAL, _FEWEST = 25, 99.0, 200
_LEAST, _TIMES = (1e-3, 1.5e-3), (8.0, 7.0)
"""Least steps, m and rad, and their least ratio to what 99 % elsewhere in the recording are below."""
_HELD_S, _HELD_ROWS = 0.06, 2.5
"""Time without another pose, s and typical rows, that is a gap."""
_SEVERAL, _QUARTER = 3, 4
_HIDDEN = (
    "{} of {} recordings have a ground truth that steps, as where parts of two cameras or maps are joined; "
    "here a step may be hidden by noise: calibrate the cameras together"
)
_CHANGE, _CHANGES, _TYPICAL, _NOTHING = 0.2, 10, 90.0, 1e-9


@dataclass(frozen=True)
class Seam:
    """The largest step of a ground truth: time since its begin, s, way, m, and turn, rad; 0 where usual."""

    at_s: float
    way_m: float
    turn_rad: float

    def in_words(self) -> str:
        """The step as a sentence."""
        sizes = [f"{1e3 * self.way_m:.1f} mm"] if self.way_m else []
        sizes += [f"{1e3 * self.turn_rad:.1f} mrad"] if self.turn_rad else []
        return (
            f"its ground truth steps by {' and '.join(sizes)} {self.at_s:.1f} s after its begin, at one "
            "instant and beside its wheels: parts of two cameras or maps are joined there, or the robot was "
            "pushed; calibrate the cameras together"
        )


def with_truth_seams(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` name steps from 1 mm or 1.5 mrad on that stand out of the noise.

    Where three recordings, and a quarter of all, have one, so may the others in which noise hides it: all
    contradict.
    """
    found = [None if one.contradictions else seam(one) for one in recordings]
    many = sum(own is not None for own in found)
    hidden = _HIDDEN.format(many, len(found)) if many >= _SEVERAL and _QUARTER * many >= len(found) else ""
    said = [hidden if own is None else own.in_words() for own in found]
    return [
        one.contradicted(why) if why and not one.contradictions else one
        for one, why in zip(recordings, said, strict=True)
    ]


def seam(one: Recording) -> Seam | None:
    """The largest step of a recording that stands out; None where none does, or rows are too few."""
    if not one.has_truth or one.of_twist or is_slow(one.truth_t_s):
        return None
    begin_s, end_s = max(one.t_s[0], one.truth_t_s[0]), min(one.t_s[-1], one.truth_t_s[-1])
    grid_s = np.arange(begin_s, end_s, _GRID_S)
    if len(grid_s) < _FEWEST:
        return None
    pose, wheels = interpolate(grid_s, one.truth_t_s, one.truth_pose), one.nominal.geometry
    rotation, steering = wheel_steps(one, grid_s, "position")
    x, y, turn = forward(wheels, rotation * wheels.radius_m, steering).T
    middle = np.exp(0.5j * (pose[1:, 2] + pose[:-1, 2]))
    place = np.diff(pose[:, 0] + 1j * pose[:, 1]) - (x + 1j * y) * middle
    counts = _steady(np.column_stack([x, y, turn])) & _measured(one, grid_s)
    sizes = [_steps(rest, counts) for rest in (place, np.diff(pose[:, 2]) - turn)]
    (way_m, at), (turn_rad, then) = (_largest(*how) for how in zip(sizes, _LEAST, _TIMES, strict=True))
    if not way_m and not turn_rad:
        return None
    return Seam(float(grid_s[_WIDE + (at if way_m else then)] - one.t_s[0]), way_m, turn_rad)


def _measured(one: Recording, grid_s: Array) -> Bools:
    """Mask (n,) of instants around which no pose lacks or is held; poses before a gap may be held, too."""
    new = np.concatenate([[True], np.any(np.diff(one.truth_pose, axis=0) != 0.0, axis=1)])
    at_s = one.truth_t_s[new]
    lasts_s = np.append(np.diff(at_s), np.inf)
    behind = np.clip(np.searchsorted(at_s, grid_s, "right") - 1, 0, len(at_s) - 1)
    lacks = lasts_s[behind] > max(_HELD_S, _HELD_ROWS * float(np.median(lasts_s)))
    return np.asarray(np.convolve(lacks, np.ones(2 * (_WIDE + _CHANGES) + 1), "same") == 0.0, dtype=np.bool_)


def _largest(size: Array, least: float, times: float) -> tuple[float, int]:
    """The largest of steps (k,) and its index; 0 where it is below the least or usual in this recording."""
    at = int(np.argmax(size))
    elsewhere = np.delete(size, slice(max(0, at - _BESIDE), at + _BESIDE + 1))
    usual = float(np.percentile(elsewhere, _USUAL)) if len(elsewhere) else np.inf
    return (float(size[at]), at) if size[at] > max(least, times * usual) else (0.0, at)


def _steps(moved: npt.NDArray[np.inexact], counts: Bools) -> Array:
    """Sizes (k,) of steps at instants of a path of moves (n,), the smaller of two measures; 0 if not counted.

    The wide window leaves out its half at both ends.
    """
    path = np.concatenate([[0.0], np.cumsum(moved)])
    wide, narrow = (np.convolve(path, _kernel(half)[::-1], "valid") for half in (_WIDE, _NARROW))
    narrow = narrow[_WIDE - _NARROW : len(narrow) - _WIDE + _NARROW]
    alike = (wide * np.conj(narrow)).real > 0.0
    both = np.where(alike, np.minimum(np.abs(wide), np.abs(narrow)), 0.0)
    return np.asarray(both * counts[_WIDE : len(counts) - _WIDE], dtype=np.float64)


def _kernel(half: int) -> Array:
    """Weights (2 half + 1,) that give the step in the middle of values on a line."""
    at = np.arange(-half, half + 1) / half
    rows = np.column_stack([np.ones_like(at), at, 0.5 * np.sign(at)])
    return np.asarray(np.linalg.pinv(rows)[2], dtype=np.float64)


def _steady(moves: Array) -> Bools:
    """Mask (n + 1,) of instants between moves (n, 3) around which the wheels neither start nor stop."""
    n = _CHANGES
    speed = np.pad(moves, ((n, n + 1), (0, 0)), mode="edge")
    change = np.abs(speed[2 * n :] - speed[: -2 * n])
    size = np.linalg.norm(moves, axis=1)
    usual = float(np.percentile(size, _TYPICAL)) if len(size) else 0.0
    quiet = np.linalg.norm(change, axis=1) <= _CHANGE * usual + _NOTHING
    near = np.convolve(~quiet, np.ones(2 * n + 1), "same") > 0
    return np.asarray(~near, dtype=np.bool_)
