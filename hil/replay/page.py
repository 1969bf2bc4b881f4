"""Figures and one self-contained HTML page that compare estimators on a recording."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hil.estimator.consistency import nees
from hil.replay.comparison import consistency, errors
from hil.ring.motion import Motion
from hil.vocabulary.files import write_text
from hil.vocabulary.geometry import wrap_array

_TRUTH = "#3f3f46"
_COLOURS = ("#2563eb", "#d97706", "#059669", "#9333ea", "#dc2626")
_DPI = 110
_POLICY = (
    "<meta http-equiv='Content-Security-Policy' content=\"default-src 'none'; img-src data:; "
    "style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'\">"
)
_IDEAL_NEES = 3.0


def write_replay_page(path: Path, title: str, motions: Mapping[str, Motion], facts: tuple[str, ...]) -> None:
    """Write the page.

    Args:
        path: HTML file.
        title: heading.
        motions: the same run as recorded and as each estimator sees it.
        facts: lines under the heading (what was verified, what could not be read).

    Raises:
        DataError: the file cannot be written.
    """
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td>"
        + "".join(f"<td>{value:.4g}</td>" for value in _figures(motion).values())
        + "</tr>"
        for name, motion in motions.items()
    )
    head = "".join(f"<th>{html.escape(k)}</th>" for k in ("estimator", *_figures(Motion(()))))
    page = (
        "<!doctype html><meta charset='utf-8'>"
        + _POLICY
        + "<style>body{font:15px sans-serif;max-width:60em;margin:2em}"
        "td,th{padding:.2em .8em;text-align:right}img{max-width:100%}</style>"
        f"<title>{html.escape(title)}</title><h1>{html.escape(title)}</h1>"
        + "".join(f"<p>{html.escape(line)}</p>" for line in facts)
        + f"<table><tr>{head}</tr>{rows}</table>"
        + "".join(
            _image(figure) for figure in (_paths(motions), _errors_over_time(motions), _confidence(motions))
        )
    )
    write_text(path, page)


def _figures(motion: Motion) -> dict[str, float]:
    return errors(motion) | consistency(motion)


def _image(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    return f"<p><img alt='' src='data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}'></p>"


def _paths(motions: Mapping[str, Motion]) -> Figure:
    """Wall view: X up, Y to the left."""
    figure = Figure(figsize=(7, 6), layout="constrained")
    axes = figure.add_subplot()
    truth = next(iter(motions.values())).mocap
    axes.plot(truth[:, 1], truth[:, 0], color=_TRUTH, linewidth=2.5, label="motion capture")
    for (name, motion), colour in zip(motions.items(), _COLOURS, strict=False):
        axes.plot(motion.estimate[:, 1], motion.estimate[:, 0], color=colour, label=name)
    axes.invert_xaxis()
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="Y (m)", ylabel="X (m)", title="Path on the wall")
    axes.legend()
    return figure


def _errors_over_time(motions: Mapping[str, Motion]) -> Figure:
    figure = Figure(figsize=(7, 5), layout="constrained")
    position, heading = figure.subplots(2, 1, sharex=True)
    for (name, motion), colour in zip(motions.items(), _COLOURS, strict=False):
        difference = motion.estimate - motion.mocap
        position.plot(
            motion.t_s, 1e3 * np.hypot(difference[:, 0], difference[:, 1]), color=colour, label=name
        )
        heading.plot(motion.t_s, np.degrees(wrap_array(difference[:, 2])), color=colour)
    position.set(ylabel="position error (mm)", title="Against motion capture")
    heading.set(xlabel="time (s)", ylabel="heading error (deg)")
    position.legend()
    return figure


def _confidence(motions: Mapping[str, Motion]) -> Figure:
    """NEES of the pose over time, on a logarithmic axis: 3 is ideal, more is over-confident."""
    figure = Figure(figsize=(7, 3.2), layout="constrained")
    axes = figure.add_subplot()
    for (name, motion), colour in zip(motions.items(), _COLOURS, strict=False):
        difference = motion.estimate - motion.mocap
        difference[:, 2] = wrap_array(difference[:, 2])
        axes.plot(motion.t_s, nees(difference, motion.covariance[:, :3, :3]), color=colour, label=name)
    axes.axhline(_IDEAL_NEES, color=_TRUTH, linewidth=1.0, linestyle="--")
    axes.set(xlabel="time (s)", ylabel="NEES of the pose", title="How sure against how wrong", yscale="log")
    axes.set_ylim(1e-2, None)
    axes.legend()
    return figure
