"""The pages of a replayed recording: comparison of estimators (error, covariance), or verified decisions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.core.geometry import Array, wrap_array
from hil.estimator.nees import nees
from hil.loop.driven_motion import Motion
from hil.report.overview import Drawn, Overview, Table, write_overview
from hil.report.page_formats import number
from hil.report.plot_style import PALETTE, SERIES, legend, new_figure, plain_log, share_scale, style, thin

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Numbers = Mapping[str, Mapping[str, float | None]]

_DEG = math.degrees(1.0)
_ERRORS = (
    ("rmse_position_m", "position RMSE (mm)", 1e3),
    ("rmse_theta_rad", "heading RMSE (deg)", _DEG),
    ("final_position_m", "at the end (mm)", 1e3),
    ("max_position_m", "largest (mm)", 1e3),
)
_SURE = (
    ("nees_pose", "NEES", 1.0),
    ("nis_wheels", "NIS wheels", 1.0),
    ("nis_gyro", "NIS gyro", 1.0),
    ("nis_tracker", "NIS camera", 1.0),
    ("nis_gravity", "NIS gravity", 1.0),
    ("lag1_gyro", "gyro, correlation", 1.0),
    ("rejected_wheels", "wheels left out", 1.0),
    ("rejected_gyro", "gyro left out", 1.0),
    ("rejected_tracker", "camera left out", 1.0),
)
_NAMES = {"recorded": "as recorded", "ekf": "EKF", "ukf": "UKF"}
_VERDICTS = {
    "identical": "Every measurement, estimate, reference, setpoint, command and event repeats bit for bit.",
    "agrees": "By different arithmetic, recording and replay differ in the last digits, within the limits.",
    "differs": "The replay differs from the recording.",
}
_IDEAL_NEES = 3.0
_LEAST_NEES, _MOST_NEES = 1e-2, 1e6
_SAME_M = 1e-9
_LITTLE_M = 0.05


def write_replay_page(
    path: Path,
    title: str,
    motions: Mapping[str, Motion],
    truth: Array,
    numbers: Numbers,
    warnings: Sequence[str] = (),
    facts: Sequence[str] = (),
    *,
    on_wall: bool = True,
    said: str = "",
) -> Path:
    """Write the page; return its path.

    Args:
        path: HTML file.
        title: heading.
        motions: the same run, as recorded and as estimated by each estimator, by name.
        truth: `hil.replay.estimator_comparison.truth_of` the run, shape (n, 3).
        numbers: `hil.replay.estimator_comparison.table` of the motions.
        warnings: texts above the figures, about data that could not be read or are implausible.
        facts: texts about the available sensors.
        on_wall: True if x points up.
        said: sentence below the heading; if empty, a sentence about the errors.

    Raises:
        DataError: the file cannot be written.
    """
    drawn = dict(_drawn(motions))
    figures = [
        Drawn(
            "errors",
            "Errors",
            _errors(drawn, truth),
            "Estimate minus motion capture." + (" X is up the wall, Y to the left." if on_wall else ""),
        ),
        Drawn(
            "path",
            "Path",
            _path(drawn, truth, on_wall),
            "Motion capture and estimates. For a line along X or Y, the sideways direction is enlarged.",
        ),
        Drawn(
            "confidence",
            "Claimed and actual error",
            _confidence(drawn, truth),
            "NEES: the squared error over the variance that the estimator claims. Three (dashed) is ideal; "
            "more means that the claimed variance is too small.",
        ),
    ]
    tables = [
        _table("Errors against motion capture", _ERRORS, numbers),
        _table(
            "Consistency of each estimator",
            _SURE,
            numbers,
            "NEES is ideal at 3, NIS at 1, the correlation of the gyro's innovations at 0. The last "
            "columns count measurements that were refused.",
        ),
    ]
    return write_overview(path, Overview(title, said or _sentence(numbers), figures, tables, warnings, facts))


def write_verification_page(
    path: Path, title: str, found: Mapping[str, Any], warnings: Sequence[str] = ()
) -> Path:
    """Write the page of a verified recording; return its path.

    Args:
        path: HTML file.
        title: heading.
        found: result of `hil.replay.verification.verify_recording`.
        warnings: texts about data that could not be read.

    Raises:
        DataError: the file cannot be written.
    """
    runs = [[str(run["run"]), str(run["cycles"]), run["verdict"]] for run in found["runs"]]
    tables = [Table("Runs", ["run", "cycles", "verdict"], runs)]
    then, here = found["recorded_with"], found["verified_with"]
    if found["verdict"] != "identical" and then != here:
        limits = found["limits"]
        rows = [
            [name, f"{value:.2g}", f"{limits[name]['value']:g}", limits[name]["unit"]]
            for name, value in found["largest"].items()
        ]
        head = ["quantity", "largest difference", "limit", "unit"]
        tables.append(Table("Largest differences", head, rows))
    rows = [[key, then.get(key, "unknown"), value] for key, value in here.items()]
    tables.append(Table("Arithmetic", ["part", "recorded with", "verified with"], rows))
    differ = [
        f"Run {run['run']}, {run['difference']}. {run.get('remark', '')}"
        for run in found["runs"]
        if run["difference"] is not None
    ]
    sentence = _VERDICTS[found["verdict"]]
    if differ and then == here:
        sentence += " Both were computed by the same arithmetic, so every bit has to be equal."
    elif not then:
        sentence += " The recording does not say by what arithmetic it was made."
    return write_overview(path, Overview(title, sentence, [], tables, [*differ, *warnings]))


def _sentence(numbers: Numbers) -> str:
    known = {n: 1e3 * v for n, row in numbers.items() if (v := row["rmse_position_m"]) is not None}
    if not known:
        return "The recording has no motion capture, so it does not show which estimator was right."
    said = ", ".join(f"{_name(name)} {number(round(error, 2))}" for name, error in known.items())
    best = _name(min(known, key=lambda name: known[name]))
    return f"Position errors against motion capture (RMSE in mm): {said}. The smallest is that of {best}."


def _name(name: str) -> str:
    return _NAMES.get(name, name)


def _drawn(motions: Mapping[str, Motion]) -> Iterator[tuple[str, Motion]]:
    """Yield label and motion of each curve; equal estimates are merged into one."""
    groups: list[tuple[list[str], Motion]] = []
    for name, motion in motions.items():
        same = next((g for g in groups if _same(g[1], motion)), None)
        if same is not None:
            same[0].append(_name(name))
        else:
            groups.append(([_name(name)], motion))
    for names, motion in groups:
        yield " = ".join(names).replace("$", r"\$"), motion  # else matplotlib parses a formula


def _same(one: Motion, other: Motion) -> bool:
    a, b = one.estimate, other.estimate
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=0.0, atol=_SAME_M, equal_nan=True))


def _difference(motion: Motion, truth: Array) -> Array:
    """Return estimate minus truth (n, 3), m and rad."""
    difference: Array = motion.estimate - truth
    difference[:, 2] = wrap_array(difference[:, 2])
    return difference


def _errors(motions: Mapping[str, Motion], truth: Array) -> Figure:
    figure = new_figure(5.2, 5.0)
    units = (("x error (mm)", 1e3), ("y error (mm)", 1e3), ("heading error (deg)", _DEG))
    for k, (label, factor) in enumerate(units):
        axes = style(figure.add_subplot(3, 1, k + 1), "time (s)" if k == 2 else "", label)
        axes.axhline(0.0, color=PALETTE["reference"], lw=1.0)
        for (name, motion), colour in zip(motions.items(), cycle(SERIES), strict=False):
            error = factor * _difference(motion, truth)[:, k]
            axes.plot(*thin(motion.t_s, error), color=colour, lw=1.2, label=name)
        if k == 0:
            legend(axes, columns=3, above=True)
    return figure


def _path(motions: Mapping[str, Motion], truth: Array, on_wall: bool) -> Figure:
    """Draw the path as seen in front of the wall, X up, Y left; an axis with little motion is enlarged."""
    known = truth[np.isfinite(truth).all(axis=1), :2]
    extent = np.ptp(known, axis=0) if len(known) else np.ones(2)
    (in_x, x_unit), (in_y, y_unit) = ((1e3, "mm") if w < _LITTLE_M else (1.0, "m") for w in extent)
    figure = new_figure(5.2, 3.6)
    left, up = (", left", ", up") if on_wall else ("", "")
    axes = style(figure.add_subplot(), f"Y{left} ({y_unit})", f"X{up} ({x_unit})")
    axes.plot(in_y * truth[:, 1], in_x * truth[:, 0], color=PALETTE["truth"], lw=2.2, label="motion capture")
    for (name, motion), colour in zip(motions.items(), cycle(SERIES), strict=False):
        x, y = motion.estimate[:, 0], motion.estimate[:, 1]
        axes.plot(in_y * y, in_x * x, color=colour, lw=1.1, label=name)
    axes.invert_xaxis()
    if x_unit == y_unit:
        share_scale(axes, *extent)
    legend(axes)
    return figure


def _confidence(motions: Mapping[str, Motion], truth: Array) -> Figure:
    figure = new_figure(5.2, 2.8)
    axes = style(figure.add_subplot(), "time (s)", "NEES of the pose")
    for (name, motion), colour in zip(motions.items(), cycle(SERIES), strict=False):
        values = nees(_difference(motion, truth), motion.covariance[:, :3, :3])
        shown = np.where(values > 0, np.clip(values, _LEAST_NEES, _MOST_NEES), np.nan)
        axes.plot(*thin(motion.t_s, shown), color=colour, lw=1.1, label=name)
    axes.axhline(_IDEAL_NEES, color=PALETTE["truth"], lw=1.0, ls="--")
    plain_log(axes)
    legend(axes, columns=3, above=True)
    return figure


def _table(title: str, columns: Sequence[tuple[str, str, float]], numbers: Numbers, note: str = "") -> Table:
    """Return a table of the columns that have at least one value."""
    known = [c for c in columns if any(row.get(c[0]) is not None for row in numbers.values())]
    rows = [
        [_name(name), *(number(_times(row.get(key), factor)) for key, _, factor in known)]
        for name, row in numbers.items()
    ]
    return Table(title, ["estimator", *(label for _, label, _ in known)], rows, note)


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value
