"""Finds the unit of wheel rates by their factor against the wheel angles, and an encoder that is stuck."""

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.column_units import RATES, Unit
from hil.datasets.wrong_units import UnitError

_STRETCH_S = 0.5
_MOST = 0.7
_FEWEST = 3
_SLOWEST_RAD_S = 0.2
_DISAGREE, _SAME_UNIT = float(np.log(2.0)), 0.2
_SCALED, _STEADY = float(np.log(1.2)), float(np.log(1.1))
"""Least factor of rates that is named where it is steady, and by how much a steady factor varies."""
_STILL_RAD, _STILL_STRETCHES, _CAUGHT_UP = 0.01, 2, 0.5


def check_rates(where: str, t_s: Array, angle: Array, rate: Array) -> None:
    """Refuse wheel rates that are not the time derivative of the wheel angles, in rad/s.

    A wheel counts if it turns at 0.2 rad/s or more, by angle or rate, in at least three stretches: a register
    that counts in steps is inaccurate at lower speeds. It disagrees if seven tenths of them are off by a
    factor of two or more, or have the opposite sign, or if as many are off by one factor, from 1.2 on. If all
    wheels have the opposite sign, `hil.datasets.wrong_signs` reports it. An angle that stands still for a
    second while its rate goes on is a stuck encoder.

    Args:
        where: the file, for messages.
        t_s: (n,) times, s, increasing.
        angle: (n, 4) wheel angles, rad, unwrapped.
        rate: (n, 4) wheel rates; not checked if one is not finite.

    Raises:
        DataError: names the columns, and the unit where the factor shows it.
    """
    if not np.all(np.isfinite(rate)):
        return
    edges_s = np.arange(t_s[0], t_s[-1], _STRETCH_S)
    way = np.vstack([np.zeros(4), np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t_s)[:, None], axis=0)])
    pairs = (np.diff([np.interp(edges_s, t_s, c) for c in columns.T]) for columns in (angle, way))
    turns = list(zip(*pairs, strict=True))
    for i, (by_angle, by_rate) in enumerate(turns):
        _check_stuck(where, i, by_angle, by_rate)
    ratios = [_ratios(by_angle, by_rate) for by_angle, by_rate in turns]
    counted = [r for r in ratios if len(r)]
    if counted and all(np.median(r) < 0.0 for r in counted):
        return
    wrong = [i for i, r in enumerate(ratios) if len(r) and (np.mean(_agrees(r)) <= 1.0 - _MOST or _scaled(r))]
    if not wrong:
        return
    factor = float(np.median(np.concatenate([ratios[i] for i in wrong])))
    names = ", ".join(f"w{i + 1}" for i in wrong)
    unit = _rate_unit(factor)
    if unit is None:
        raise DataError(
            where,
            f"wheel rates ({names}) disagree with the wheel angles (phi): {factor:.3g} times the rate at "
            "which those grow",
            expected="w in rad/s, the rate at which phi grows",
            remedy="correct the columns, or leave out w1 to w4, which only the signal velocity needs",
        )
    raise UnitError(
        where,
        f"wheel rates ({names}) seem to be in {unit.name}: {factor:.3g} times the rates of the angles (phi)",
        {"w": unit.to_si},
        expected="w in rad/s",
        remedy=f"multiply w by {unit.to_si:.6g}",
    )


def _check_stuck(where: str, wheel: int, by_angle: Array, by_rate: Array) -> None:
    """Refuse an angle that stands still while its rate says that the wheel rolls, and does not catch up.

    Args:
        where: the file, for messages.
        wheel: index of the wheel.
        by_angle: (s,) turn by the angle in each stretch, rad.
        by_rate: (s,) turn by the rate, rad.

    Raises:
        DataError: names the column, and when it stands still.
    """
    stuck = (np.abs(by_angle) < _STILL_RAD) & (np.abs(by_rate) > _SLOWEST_RAD_S * _STRETCH_S)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stuck, [False]]).astype(np.int8)))
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        rolled = float(by_rate[begin:end].sum())
        caught_up = float(by_angle[begin : end + 1].sum()) / rolled > _CAUGHT_UP
        if end - begin < _STILL_STRETCHES or caught_up:
            continue
        raise DataError(
            where,
            f"phi{wheel + 1} stands still while w{wheel + 1} rolls: by {abs(rolled):.2g} rad in the "
            f"{_STRETCH_S * (end - begin):.1f} s from {_STRETCH_S * begin:.1f} s after its begin",
            expected="w in rad/s, the rate at which phi grows",
            remedy="look for a stuck encoder; leave the recording out, cut it there, or, where the wheel did "
            "stand, leave out w1 to w4",
        )


def _scaled(ratio: Array) -> bool:
    """Whether ratios (s,) are of one factor, 1.2 or more, but for three tenths of them."""
    off = np.log(np.maximum(ratio, 1e-12))
    middle = float(np.median(off))
    return abs(middle) > _SCALED and bool(np.mean(np.abs(off - middle) < _STEADY) >= _MOST)


def _ratios(by_angle: Array, by_rate: Array) -> Array:
    """Turn of one wheel by rate over turn by angle, per stretch; empty where too few stretches count."""
    turns = np.maximum(np.abs(by_angle), np.abs(by_rate)) > _SLOWEST_RAD_S * _STRETCH_S
    if np.count_nonzero(turns) < _FEWEST:
        return np.empty(0)
    nonzero = np.where(np.abs(by_angle) < 1e-9, 1e-9, by_angle)
    return np.asarray(by_rate[turns] / nonzero[turns], dtype=np.float64)


def _agrees(ratio: Array) -> Array:
    return np.asarray(np.abs(np.log(np.maximum(ratio, 1e-12))) < _DISAGREE)


def _rate_unit(factor: float) -> Unit | None:
    """Unit whose numbers are `factor` times rad/s; None where no unit is near."""
    if factor <= 0.0:
        return None
    off, unit = min(((abs(np.log(factor * unit.to_si)), unit) for unit in RATES), key=lambda found: found[0])
    return unit if off < _SAME_UNIT else None
