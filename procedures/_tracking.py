"""Figures of one tracked motion: errors of the true pose against the reference, and series to draw."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hil.geometry import Array, wrap_array
from hil.motion import Motion
from hil.report.run_plots import PALETTE, SERIES, legend, new_figure, style, thin

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.bench import Bench

_END_S = 0.3
COLOURS = dict(zip(("odometry", "ekf", "ukf", "optimal"), SERIES, strict=False))


def stand(bench: Bench, duration_s: float = 0.5) -> Array:
    """Take hold of the wall and return where the robot stands, (3,)."""
    bench.rig.actuators().enable()
    return bench.settle(duration_s)


def tracking_errors(motion: Motion) -> dict[str, float]:
    """Truth (motion capture) against reference: errors in mm and deg, ends after the hold.

    Keys: `rmse_x`, `rmse_y`, `rmse_heading` over the motion, `worst` (distance), `end_x`, `end_y`,
    `end_heading` (truth minus reference), `saturated_s`, `steering_travel` (rad, mean of the wheels).
    """
    error = motion.mocap - motion.reference
    error[:, 2] = wrap_array(error[:, 2])
    moving = np.array([r.reference is not None and not r.reference.done for r in motion.records])
    known = np.all(np.isfinite(error), axis=1)
    t_s = motion.t_s
    ending = known & (t_s > t_s[-1] - _END_S)
    if not np.any(known & moving) or not np.any(ending):
        return dict.fromkeys(_KEYS, float("nan"))
    scale = np.array([1e3, 1e3, np.degrees(1.0)])
    rmse = np.sqrt(np.mean(error[known & moving] ** 2, axis=0)) * scale
    end = error[ending].mean(axis=0) * scale
    rates = np.array([np.max(np.abs(r.setpoint.wheel_rate_rad_s)) for r in motion.records])
    steering = motion.wheels[:, 4:]
    travel = np.nansum(np.abs(np.diff(steering, axis=0)), axis=0).mean()
    values = (
        *rmse, np.hypot(error[known, 0], error[known, 1]).max() * 1e3, *end,
        np.count_nonzero(rates > 0.995 * 4.8) * float(np.median(np.diff(t_s))), travel,
    )  # fmt: skip
    return dict(zip(_KEYS, map(float, values), strict=True))


_KEYS = (
    "rmse_x", "rmse_y", "rmse_heading", "worst", "end_x", "end_y", "end_heading", "saturated_s",
    "steering_travel",
)  # fmt: skip


def series(motion: Motion) -> dict[str, Any]:
    """Time, reference, truth and estimate, thinned, as JSON values."""
    columns = thin(motion.t_s, *motion.reference.T, *motion.mocap.T, *motion.estimate.T)
    rounded = [np.round(c, 5).tolist() for c in columns]
    return {"t": rounded[0], "reference": rounded[1:4], "truth": rounded[4:7], "estimate": rounded[7:10]}


def path_figure(runs: dict[str, dict[str, Any]]) -> Figure:
    """Where the robot went, by feedback, beside the reference; X up the wall, Y to the left."""
    figure = new_figure(6.4, 4.2)
    axes = style(figure.add_subplot(), "Y, left (m)", "X, up the wall (m)")
    first = next(iter(runs.values()))
    axes.plot(*_up(first["reference"]), color=PALETTE["reference"], lw=1.6, label="reference")
    for name, run in runs.items():
        axes.plot(*_up(run["truth"]), color=COLOURS.get(name, SERIES[4]), lw=1.4, label=name)
    axes.invert_xaxis()
    across = np.ptp(np.array(first["reference"][1])), np.ptp(np.array(first["reference"][0]))
    if min(across) > 0.1:
        axes.set_aspect("equal", adjustable="datalim")
    legend(axes)
    return figure


def time_figure(runs: dict[str, dict[str, Any]]) -> Figure:
    """x, y and heading against time: reference, truth (full line) and estimate (dashed)."""
    figure = new_figure(6.4, 6.4)
    labels = ("x (m)", "y (m)", "heading (deg)")
    for k, label in enumerate(labels):
        axes = style(figure.add_subplot(3, 1, k + 1), "time (s)" if k == 2 else "", label)
        factor = np.degrees(1.0) if k == 2 else 1.0
        first = next(iter(runs.values()))
        axes.plot(
            first["t"], np.array(first["reference"][k], float) * factor, color=PALETTE["reference"], lw=1.6,
            label="reference",
        )  # fmt: skip
        for name, run in runs.items():
            colour = COLOURS.get(name, SERIES[4])
            axes.plot(run["t"], np.array(run["truth"][k], float) * factor, color=colour, lw=1.3, label=name)
            axes.plot(run["t"], np.array(run["estimate"][k], float) * factor, color=colour, lw=1.0, ls="--")
        if k == 0:
            legend(axes, columns=2)
    return figure


def _up(pose: list[list[float]]) -> tuple[Array, Array]:
    return np.array(pose[1], dtype=np.float64), np.array(pose[0], dtype=np.float64)
