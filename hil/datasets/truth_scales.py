"""Compares lengths of ground truth between motions: curves against lines, and lines in two directions.

One scale of all lengths is that of the wheel radii. Radii that differ from wheel to wheel make curves to one
side longer and to the other shorter, in proportion to how much they bend, and leave lines as they are. So
what curves of both sides have in common and lines have not is no property of the wheels.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.datasets.truth_deviations import STDS
from hil.datasets.truth_noise import MEDIAN
from hil.datasets.wheel_displacements import Complexes
from hil.datasets.wheel_log import Recording
from hil.datasets.wheel_stretches import Stretches

_BENT, _STRAIGHT, _MOST_BENT = 0.4, 0.25, 6.0
"""Curvature of curves, of lines, and up to which curves count, 1/m."""
_CURVES, _LINES = 0.008, 0.015
"""Differences that are named, where they are four standard errors as well: contact with dry friction makes up
to 0.002 and 0.0125 of radii 2.5 % apart."""
_ASIDE_RAD, _AS_BENT, _ALIKE = 0.3, 0.1, 0.5
"""Difference of directions of travel that are one; share by which wheels and truth may bend unlike."""


@dataclass(frozen=True)
class _Length:
    """Lengths of a recording.

    Attributes:
        scale: way by ground truth over way by wheels.
        std: its standard error by white noise of the ground truth.
        bend: curvature, 1/m.
        aside_rad: direction of travel in the body.
    """

    scale: float
    std: float
    bend: float
    aside_rad: float


def with_truth_scales(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` of curves that are longer than lines; `notes` on unlike lines."""
    every = [None if one.contradictions else _length(one) for one in recordings]
    known = [own for own in every if own is not None]
    out, (off, curves) = list(recordings), _curves_beyond_lines(every)
    if abs(off) > _CURVES:
        said = (
            f"curves are {1.0 + off:.3f} times as long by ground truth as lines, to both sides, for the way "
            "of their wheels: no wheels do that. Lengths of its ground truth have another scale there, or "
            "those of the lines; take all recordings with one calibration of the cameras"
        )
        for k in curves:
            out[k] = out[k].contradicted(said)
    unlike = _sideways_beyond_ahead(known)
    if abs(unlike) > _LINES and out:
        note = (
            f"lines to the side are {1.0 + unlike:.3f} times as long by ground truth, for the way of their "
            "wheels, as lines ahead: either one axis of the capture system has another scale, or the wheels "
            "slip more in one direction; these recordings cannot tell. Circles would"
        )
        out[0] = replace(out[0], notes=(*out[0].notes, note))
    return out


def _length(one: Recording) -> _Length | None:
    own = Stretches.of(one)
    if own is None or own.scale is None:
        return None
    wheels = one.nominal.geometry
    places = wheels.x_m + 1j * wheels.y_m
    bend, true_bend = (_bend(ways, places - places.mean()) for ways in (own.rolled, own.moved))
    if abs(true_bend - bend) > _AS_BENT * abs(bend) + _STRAIGHT:
        return None
    way = own.moved.mean(axis=1)
    return _Length(own.scale, own.scale_std, bend, float(np.angle(np.sum(way**2)) / 2.0))


def _bend(ways: Complexes, lever: Complexes) -> float:
    """Turn per way, 1/m, of ways (s, 4) of wheels at places (4,) about their middle."""
    turned = (np.conj(1j * lever) * ways).real.sum(axis=1) / float((np.abs(lever) ** 2).sum())
    return float(np.sum(turned) / max(np.sum(np.abs(ways.mean(axis=1))), 1e-9))


def _curves_beyond_lines(every: Sequence[_Length | None]) -> tuple[float, list[int]]:
    """Share by which curves are longer than lines, and their indices; 0 without curves to both sides.

    Compared are lines and curves on which the body looks the same way, as contact may differ by direction.
    The scale of the curves is that at no curvature. Noise of the ground truth gives standard errors. Curves
    to one side that differ by half as much among each other are no case of this.
    """
    known = [(k, own) for k, own in enumerate(every) if own is not None]
    lines = [own for _, own in known if abs(own.bend) < _STRAIGHT]
    curves = [(k, own) for k, own in known if _BENT < abs(own.bend) < _MOST_BENT]
    found: tuple[float, list[int]] = (0.0, [])
    for _, one in curves:
        ways = [own for own in lines if _between(own.aside_rad, one.aside_rad) < _ASIDE_RAD]
        alike = [(k, own) for k, own in curves if _between(own.aside_rad, one.aside_rad) < _ASIDE_RAD]
        bends = np.array([own.bend for _, own in alike])
        if not ways or not bends.min() < 0.0 < bends.max():
            continue
        rows = np.column_stack([np.ones_like(bends), bends])
        scales = np.array([own.scale for _, own in alike])
        weights = np.linalg.pinv(rows)[0]
        line, line_std = _middle(ways)
        off = float(weights @ scales) / line - 1.0
        std = float(np.hypot(np.linalg.norm(weights * [own.std for _, own in alike]), line_std))
        spread = max(float(np.ptp(scales[side])) for side in (bends > 0.0, bends < 0.0))
        if spread < _ALIKE * abs(off) and abs(off) > STDS * std:
            found = max(found, (off, [k for k, _ in alike]), key=lambda own: abs(own[0]))
    return found


def _between(one_rad: float, other_rad: float) -> float:
    """Angle between two directions of travel, rad; ahead and back are one."""
    return abs((one_rad - other_rad + 0.5 * np.pi) % np.pi - 0.5 * np.pi)


def _sideways_beyond_ahead(known: Sequence[_Length]) -> float:
    """Share by which lines to the side are longer than lines ahead; 0 without both, or where curves tell."""
    lines = [own for own in known if abs(own.bend) < _STRAIGHT]
    ahead = [own for own in lines if _between(own.aside_rad, 0.0) < _ASIDE_RAD]
    aside = [own for own in lines if _between(own.aside_rad, 0.5 * np.pi) < _ASIDE_RAD]
    if not ahead or not aside or any(_BENT < abs(own.bend) < _MOST_BENT for own in known):
        return 0.0
    (ahead_scale, ahead_std), (aside_scale, aside_std) = _middle(ahead), _middle(aside)
    off = aside_scale / ahead_scale - 1.0
    return off if abs(off) > STDS * float(np.hypot(ahead_std, aside_std)) else 0.0


def _middle(lengths: Sequence[_Length]) -> tuple[float, float]:
    """Median scale and its standard error."""
    std = float(np.linalg.norm([own.std for own in lengths])) / len(lengths)
    return float(np.median([own.scale for own in lengths])), (MEDIAN if len(lengths) > 2 else 1.0) * std
