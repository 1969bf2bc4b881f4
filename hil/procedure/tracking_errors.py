"""Evaluates a tracked motion: errors of the true pose against the reference, time series and figures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hil.bench.loop_settings import geometry_of, motion_limits
from hil.config.bench import BenchConfig
from hil.core.errors import DataError
from hil.core.geometry import Array, wrap_array
from hil.loop.driven_motion import Motion
from hil.report.plot_style import (
    MOST_POINTS,
    PALETTE,
    SERIES,
    kept_rows,
    legend,
    new_figure,
    share_scale,
    style,
)
from hil.robot.motion_limits import check
from hil.robot.trajectories import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.bench import Bench

REFERENCE_M = 1.5
"""Length of the lines on the wall for which accuracy limits are given."""
STAGGER_S = 0.13
"""Extra initial rest of each repetition, so that worlds of one seed do not repeat their noise."""
_END_S, _LONGER_S = 0.3, 1.5
_LEAST_SEEN = 0.9
_LEAST_SEEN_TO_END, _FEWEST_CYCLES = 0.8, 10
COLOURS = dict(zip(("odometry", "ekf", "ukf", "optimal"), SERIES, strict=False))
LABELS = {"odometry": "odometry", "ekf": "EKF", "ukf": "UKF", "optimal": "EKF, optimal law"}
_DASHES: dict[str, Any] = {"ukf": (0, (4, 3)), "optimal": (0, (1, 1.5))}


def check_references(config: BenchConfig, references: Iterable[Trajectory]) -> None:
    """Check every reference of a run against the bench's limits before anything is opened or moved.

    Raises:
        TrajectoryError: a limit is exceeded; names the first time and value.
    """
    for trajectory in references:
        check(trajectory, geometry_of(config).projection(), motion_limits(config))


def enable_hold(bench: Bench, duration_s: float = 0.5) -> Array:
    """Enable the hold on the wall; return the pose of the standing robot, (3,)."""
    bench.devices.actuators().enable()
    return bench.settle(duration_s)


def tracking_errors(motion: Motion) -> dict[str, Any]:
    """Return errors of the truth against the reference, in mm and deg; ends after the hold.

    The truth is motion capture, or what the checks believe in its place (`Motion.truth`); `doubt` says so.

    Keys: `rmse_x`, `rmse_y`, `rmse_heading` over the motion, `worst` (distance), `end_x`, `end_y`,
    `end_heading` (truth minus reference), `saturated_s`, `steering_travel` (rad, mean of the wheels), `seen`
    (share of the motion that motion capture saw), `doubt`. RMSE and `worst` are NaN where that share is less
    than 0.9, ends where motion capture did not see the last 0.3 s.
    """
    truth, doubt = motion.truth
    error = truth - motion.reference
    error[:, 2] = wrap_array(error[:, 2])
    moving = np.array([r.reference is not None and not r.reference.done for r in motion.records])
    known = np.all(np.isfinite(error), axis=1)
    t_s = motion.t_s
    ending = known & (t_s > t_s[-1] - _END_S)
    seen = float(np.mean(known[moving])) if np.any(moving) else 0.0
    scale = np.array([1e3, 1e3, np.degrees(1.0)])
    rmse, worst, end = np.full(3, np.nan), np.nan, np.full(3, np.nan)
    if seen >= _LEAST_SEEN:
        rmse = np.sqrt(np.mean(error[known & moving] ** 2, axis=0)) * scale
        worst = np.hypot(error[known, 0], error[known, 1]).max() * 1e3
    if np.any(ending):
        end = error[ending].mean(axis=0) * scale
    rates = np.array([np.max(np.abs(r.setpoint.wheel_rate_rad_s)) for r in motion.records])
    steering = motion.wheels[:, 4:]
    travel = np.nansum(np.abs(np.diff(steering, axis=0)), axis=0).mean()
    values = (
        *rmse,
        worst,
        *end,
        np.count_nonzero(rates > 0.995 * 4.8) * float(np.median(np.diff(t_s))),
        travel,
        seen,
    )
    return {**dict(zip(_KEYS, map(float, values), strict=True)), "doubt": doubt}


_KEYS = (
    "rmse_x",
    "rmse_y",
    "rmse_heading",
    "worst",
    "end_x",
    "end_y",
    "end_heading",
    "saturated_s",
    "steering_travel",
    "seen",
)


def must_be_seen_to_its_end(known: NDArray[np.bool_], has: str, of: str) -> None:
    """Raise `DataError` unless most cycles (n,) have data, and some of the last tenth of them.

    Args:
        known: (n,) True for each cycle that has data.
        has: name of the data, for the message.
        of: name of the interval, for the message.
    """
    ended = _end_is_known(known)
    if len(known) < _FEWEST_CYCLES or np.mean(known) < _LEAST_SEEN_TO_END or not ended:
        raise DataError(
            "",
            f"{has} for {100.0 * np.mean(known):.0f} % of {of}{'' if ended else ', and not at its end'}",
            expected=f"at least {100.0 * _LEAST_SEEN_TO_END:.0f} %, and its end",
            remedy="hil run bring_up",
        )


def _end_is_known(known: NDArray[np.bool_]) -> bool:
    """Whether some of the last tenth of cycles (n,) have data."""
    return bool(np.any(known[-max(len(known) // 10, 1) :]))


def _seen(motion: Motion) -> NDArray[np.bool_]:
    return np.asarray(np.all(np.isfinite(motion.mocap), axis=1), dtype=np.bool_)


def watched_to_a_seen_end(bench: Bench, motion: Motion) -> Motion:
    """Extend a rest by up to `_LONGER_S`, until motion capture sees the robot at its end.

    Args:
        bench: bench with the robot still at rest.
        motion: the rest so far.
    """
    for _ in range(round(_LONGER_S / _END_S)):
        if _end_is_known(_seen(motion)):
            break
        motion = motion.then(bench.observe(_END_S, feedback="odometry"))
    return motion


def moved_at_rest(motion: Motion) -> float:
    """Return how far the robot moved while it should have stood still, m."""
    truth, known = motion.mocap, _seen(motion)
    must_be_seen_to_its_end(known, "motion capture", "the time that the robot stands")
    truth = truth[known]
    return float(np.hypot(*(truth[-1, :2] - truth[0, :2])))


def unseen(errors: Mapping[str, Any]) -> str:
    """Return a sentence about errors that lack motion capture data; empty if there are none."""
    if errors["doubt"]:
        return str(errors["doubt"])
    parts = []
    if errors["seen"] < _LEAST_SEEN:
        parts.append(
            f"saw {100.0 * errors['seen']:.0f} % of the motion (RMSE needs {100.0 * _LEAST_SEEN:.0f} %)"
        )
    if math.isnan(errors["end_x"]):
        parts.append(f"did not see its last {_END_S:g} s (errors at the end need them)")
    if not parts:
        return ""
    return f"motion capture {' and '.join(parts)}. Look at its cameras, and drive again."


def series(motion: Motion) -> dict[str, Any]:
    """Return time, reference, truth and estimate as JSON values, thinned; the largest errors are kept.

    Where the truth is the estimate itself, the estimate is NaN: its error is not known.
    """
    truth, doubt = motion.truth
    estimate = np.full_like(truth, np.nan) if doubt else motion.estimate
    errors = np.hstack([truth - motion.reference, estimate - truth])
    errors[:, [2, 5]] = wrap_array(errors[:, [2, 5]])
    rows = kept_rows(*errors.T, most=2 * MOST_POINTS)
    columns = (motion.t_s, *motion.reference.T, *truth.T, *estimate.T)
    rounded = [np.round(c[rows], 5).tolist() for c in columns]
    return {"t": rounded[0], "reference": rounded[1:4], "truth": rounded[4:7], "estimate": rounded[7:10]}


def path_figure(runs: dict[str, dict[str, Any]]) -> Figure:
    """Draw the path for each feedback, and the reference; X up the wall, Y to the left.

    An axis along which the reference hardly moves is enlarged, in mm below 5 cm.
    """
    first = next(iter(runs.values()))["reference"]
    extent = [np.ptp(np.array(first[k], dtype=np.float64)) for k in range(2)]
    factor, unit = zip(*((1e3, "mm") if w < 0.05 else (1.0, "m") for w in extent), strict=True)
    figure = new_figure(5.2, 3.4)
    axes = style(figure.add_subplot(), f"Y, left ({unit[1]})", f"X, up the wall ({unit[0]})")
    for name, run in {"reference": {"truth": first}, **runs}.items():
        x, y = (np.array(run["truth"][k], dtype=np.float64) * factor[k] for k in range(2))
        axes.plot(y, x, color=_colour(name), ls=_DASHES.get(name, "-"), lw=1.5, label=LABELS.get(name, name))
    axes.invert_xaxis()
    if unit[0] == unit[1]:
        share_scale(axes, *extent)
    legend(axes)
    return figure


def belief_figure(runs: dict[str, dict[str, Any]]) -> Figure:
    """Draw estimate minus truth in x, y and heading over time, for each feedback."""
    return _differences(runs, "estimate", "truth")


def coverage_figure(runs: dict[str, dict[str, Any]], seen: Array, start: Array, length_m: float) -> Figure:
    """Draw the seen cells of a scanned rectangle from its corner `start`, and the paths.

    Args:
        runs: name of the feedback to its `series`.
        seen: array (along X, along Y): True for each cell that was seen.
        start: (3,) pose at the rectangle's corner, wall frame.
        length_m: length of the rectangle along X.
    """
    from matplotlib.colors import ListedColormap

    figure = new_figure(4.3, 4.9)
    axes = style(figure.add_subplot(), "Y, left (m)", "X, up the wall (m)")
    y_m = start[1] + np.arange(seen.shape[1] + 1) * length_m / seen.shape[0]
    x_m = start[0] + np.arange(seen.shape[0] + 1) * length_m / seen.shape[0]
    shade = np.where(seen, 1.0, np.nan)
    fill = ListedColormap([PALETTE["c3"]])
    axes.pcolormesh(y_m, x_m, shade, cmap=fill, alpha=0.2, vmin=0.0, vmax=1.0, rasterized=True)
    first = next(iter(runs.values()))["reference"]
    for name, run in {"reference": {"truth": first}, **runs}.items():
        x, y = (np.array(run["truth"][k], dtype=np.float64) for k in range(2))
        axes.plot(
            y, x, color=_colour(name), lw=2.2 if name == "reference" else 1.3, label=LABELS.get(name, name)
        )
    axes.invert_xaxis()
    axes.set_aspect("equal", adjustable="datalim")
    legend(axes)
    return figure


def error_figure(runs: dict[str, dict[str, Any]]) -> Figure:
    """Draw truth minus reference in x, y and heading over time, all feedbacks together."""
    return _differences(runs, "truth", "reference")


def _differences(runs: dict[str, dict[str, Any]], which: str, against: str) -> Figure:
    figure = new_figure(5.2, 4.6)
    units = (("x error (mm)", 1e3), ("y error (mm)", 1e3), ("heading error (deg)", np.degrees(1.0)))
    for k, (label, factor) in enumerate(units):
        axes = style(figure.add_subplot(3, 1, k + 1), "time (s)" if k == 2 else "", label)
        axes.axhline(0.0, color=PALETTE["reference"], lw=1.0)
        for name, run in runs.items():
            error = np.array(run[which][k], dtype=np.float64) - np.array(run[against][k], np.float64)
            axes.plot(
                run["t"],
                (wrap_array(error) if k == 2 else error) * factor,
                color=_colour(name),
                ls=_DASHES.get(name, "-"),
                lw=1.3,
                label=LABELS.get(name, name),
            )
        if k == 0:
            legend(axes, columns=len(runs))
    return figure


def _colour(name: str) -> str:
    return PALETTE["reference"] if name == "reference" else COLOURS.get(name, SERIES[4])
