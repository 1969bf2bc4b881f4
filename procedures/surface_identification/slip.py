"""Slip per metre on a surface from driven motions, and whether the robot holds at rest."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import stdtrit

from hil.core.errors import DataError
from hil.core.geometry import Array, ArrayLike, rotation2
from hil.loop.driven_motion import Motion
from hil.procedure.tracking_errors import moved_at_rest, must_be_seen_to_its_end

_HELD_M = 2e-3
_TILT_RAD = 0.02  # angle between slip and gravity in the next line


@dataclass(frozen=True)
class Slip:
    """Slip of one motion against its wheel odometry.

    Attributes:
        downhill_m, leftward_m: displacement beyond what the wheels rolled, wall axes (-X, +Y).
        turned_rad: heading beyond what the wheels turned it.
        rolled_m: distance by the wheels.
    """

    downhill_m: float
    leftward_m: float
    turned_rad: float
    rolled_m: float

    def per_metre(self) -> tuple[float, float, float]:
        """Return downhill and leftward slip, m/m, and turning, rad/m."""
        return (
            self.downhill_m / self.rolled_m,
            self.leftward_m / self.rolled_m,
            self.turned_rad / self.rolled_m,
        )


def slip_of(motion: Motion, rolled: Array) -> Slip:
    """Return the slip: motion capture minus wheel odometry, with the odometry along the true heading.

    With the true heading a drift in heading does not appear as slip sideways. The odometry is the bench's
    own, with its wheels and its forward model, so the slip is valid for a filter with the same wheel model.

    Args:
        motion: the driven motion.
        rolled: (n, 3) poses by odometry, one per cycle.

    Raises:
        DataError: wheels or motion capture are missing for part of the motion, or the wheels did not roll.
    """
    wheels, truth = motion.wheels, motion.mocap
    known = np.all(np.isfinite(wheels), axis=1) & np.all(np.isfinite(truth), axis=1)
    must_be_seen_to_its_end(known, "wheels and motion capture together", "a motion")
    rolled, truth = rolled[known], truth[known]
    heading, by_odometry = np.unwrap(truth[:, 2]), np.unwrap(rolled[:, 2])
    off = heading - by_odometry
    turn = 0.5 * (off[1:] + off[:-1])
    c, s = np.cos(turn), np.sin(turn)
    step = np.diff(rolled[:, :2], axis=0)
    by_wheels = np.array([np.sum(c * step[:, 0] - s * step[:, 1]), np.sum(s * step[:, 0] + c * step[:, 1])])
    way_m = float(np.hypot(step[:, 0], step[:, 1]).sum())
    if way_m < 0.05:
        raise DataError(
            "surface_identification",
            f"rolled only {1e3 * way_m:.0f} mm in a motion",
            expected="the wheels to drive the line",
        )
    lost = truth[-1, :2] - truth[0, :2] - by_wheels
    turned = off[-1] - off[0]
    return Slip(float(-lost[0]), float(lost[1]), float(turned), way_m)


@dataclass(frozen=True)
class Rate:
    """Mean over opposite directions, and the half width of its 95 % interval."""

    mean: float
    half_width: float


def rate(there: ArrayLike, back: ArrayLike, systematic: float) -> Rate:
    """Return the mean of pairs driven there and back: effects of geometry (radii, steering zeros) cancel.

    Args:
        there: values per metre, one per repetition.
        back: the same in the opposite direction.
        systematic: systematic error as a share of the mean (95 %), for example by starts and stops.
    """
    pairs = 0.5 * (np.asarray(there, dtype=np.float64) + np.asarray(back, dtype=np.float64))
    mean, spread = float(pairs.mean()), 0.0
    if len(pairs) > 1:
        quantile = float(stdtrit(len(pairs) - 1, 0.975))
        spread = quantile * float(pairs.std(ddof=1)) / math.sqrt(len(pairs))
    return Rate(mean, math.hypot(spread, systematic * mean))


@dataclass(frozen=True)
class NextLine:
    """Expected slip of a line in one direction, and its sigma: (3,) per metre, wall x, wall y, turning."""

    mean: Array
    sigma: Array


def next_lines(every: Mapping[str, ArrayLike], systematic: float) -> dict[str, NextLine]:
    """Predict the slip of the next line in each direction from the driven lines.

    Args:
        every: downhill, leftward (m/m) and turning (rad/m) of each repetition, (n, 3) by direction.
        systematic: systematic error as a share of the mean, as for `rate`.
    """
    rows = {name: np.asarray(found, dtype=np.float64) for name, found in every.items()}
    n = min(len(found) for found in rows.values())
    freedom = max(1, sum(len(found) - 1 for found in rows.values()))
    spread = np.sqrt(
        sum(((found - found.mean(axis=0)) ** 2).sum(axis=0) for found in rows.values()) / freedom
    )
    away = np.array([-1.0, 1.0, 1.0])
    found = {}
    for name, own in rows.items():
        mean = own.mean(axis=0)
        unseen = 0.5 * systematic * np.abs(mean)
        unseen[1] = math.hypot(unseen[1], _TILT_RAD * mean[0])
        sigma = np.hypot(spread * math.sqrt(1.0 + 1.0 / n), unseen)
        found[name] = NextLine(away * mean, sigma)
    return found


def held(motion: Motion) -> bool:
    """Whether the robot stood still, except for the millimetre by which tyres deform.

    A robot whose weight hangs behind its wheels turns as it slides and may come to rest again.
    """
    return moved_at_rest(motion) < _HELD_M


def downhill(start: Array, way_m: float, direction: str) -> Array:
    """Goal (3,) of a line of `way_m` from `start`: `up`, `down`, `left` or `right` on the wall."""
    steps = {"up": (1.0, 0.0), "down": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}
    step_m = rotation2(float(start[2])) @ (way_m * np.array(steps[direction]))
    return np.asarray(start + np.append(step_m, 0.0), dtype=np.float64)


def draw(ctx: Any, rows: Sequence[dict[str, list[float]]]) -> None:
    """Draw the downhill slip of every motion, by direction."""
    from hil.report.plot_style import SERIES, new_figure, style

    figure = new_figure(4.6, 2.6)
    axes = style(figure.add_subplot(), "", "downhill slip (mm per m)")
    names = list(rows[0])
    for k, name in enumerate(names):
        values = [1e3 * row[name][0] for row in rows]
        axes.plot(np.full(len(values), k), values, "o", color=SERIES[0 if k < 2 else 1], ms=5, alpha=0.7)
        axes.plot([k - 0.25, k + 0.25], [np.mean(values)] * 2, color=SERIES[0 if k < 2 else 1], lw=2)
    axes.set_xticks(range(len(names)), names)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    ctx.figure(
        figure,
        "Slip by direction",
        "One point per motion. The difference between opposite directions is geometry (radii, steering "
        "zeros), their mean is slip.",
    )
