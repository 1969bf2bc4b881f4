"""Finds drive and steering angles that are clipped, scaled, drift or stand still, by where each wheel rolls.

In stretches of half a second the way of each wheel by its own angles is compared with that of the ground
truth at its place. The angle between both is the error of its steering angle. Tolerances and slip keep it the
same at all steering angles and times; what grows with one of these is named.
"""

from collections.abc import Sequence

import numpy as np

from hil.core.geometry import Array, Bools
from hil.core.signals import WHEELS
from hil.datasets.wheel_displacements import STRETCH_S
from hil.datasets.wheel_log import Recording
from hil.datasets.wheel_stretches import Stretches

_STILL_RAD, _STILL, _ROLLS = 0.01, 4, 0.3
_LIMIT_RAD, _AT_LIMIT_RAD, _BEYOND_RAD, _AT_LIMIT, _ELSEWHERE = 0.3, 1e-3, 0.1, 5, 10
_AGREES_RAD, _AS_FAR = 0.05, 0.1
_DRIFT_RAD, _OTHERS, _FEWEST, _MOST_OF = 0.05, 0.4, 4, 0.8
_SCALE, _STDS, _LEAST_STD, _MOTIONS = 0.02, 4.0, 0.003, 4
_BIN_RAD, _IN_BIN = 0.3, 5


def with_angle_faults(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` name angles that stand still, are clipped, drift or are scaled."""
    every = [Stretches.of(one) for one in recordings]
    found = {k: said for k, own in enumerate(every) if own is not None and (said := _stuck(own))}
    found |= {k: said for k, said in _clipped(every).items() if k not in found}
    left = [None if k in found else own for k, own in enumerate(every)]
    if said := _drifts(left) or _scaled(left, [one.motion for one in recordings]):
        found |= {k: said for k, own in enumerate(left) if own is not None}
    return [one.contradicted(found[k]) if k in found else one for k, one in enumerate(recordings)]


def _stuck(own: Stretches) -> str:
    """The drive angle that stands still for two seconds while its wheel goes on; else empty."""
    goes, agrees = own.goes, np.abs(own.rolled - own.moved) < _ROLLS * np.abs(own.moved)
    for i, wheel in enumerate(WHEELS):
        others = np.count_nonzero(np.delete(agrees & goes, i, axis=1), axis=1) >= 2
        still = goes[:, i] & (own.turned[:, i] < _STILL_RAD) & others
        if np.count_nonzero(still) >= _STILL:
            way_m = float(np.abs(own.moved[still, i]).sum())
            return (
                f"phi{i + 1} stands still for {STRETCH_S * np.count_nonzero(still):.1f} s, the first time "
                f"{own.at_s[still][0]:.1f} s after its begin, while the {wheel} wheel goes {way_m:.2f} m by "
                "ground truth, and others roll along: its encoder is stuck, or the wheel was dragged"
            )
    return ""


def _clipped(every: Sequence[Stretches | None]) -> dict[int, str]:
    """Steering angles that stand at their extreme of the set while their wheels go further to that side."""
    known = {k: own for k, own in enumerate(every) if own is not None}
    beyond = dict[int, dict[int, tuple[float, float]]]()
    for i, sign in ((i, sign) for i in range(len(WHEELS)) for sign in (1.0, -1.0)):
        limit_rad = max((float(np.max(sign * own.steering[..., i])) for own in known.values()), default=0.0)
        at = {k: _at_limit(own, i, sign, limit_rad) for k, own in known.items()}
        elsewhere = [own.off_rad[~at[k], i] for k, own in known.items()]
        off_rad = np.concatenate(elsewhere) if elsewhere else np.empty(0)
        if limit_rad < _LIMIT_RAD or len(off_rad) < _ELSEWHERE or np.median(np.abs(off_rad)) > _AGREES_RAD:
            continue
        for k, own in known.items():
            further = _further_rad(own, at[k], i, sign)
            if further > _BEYOND_RAD:
                beyond.setdefault(k, {})[i] = (sign * limit_rad, further)
    return {
        k: "; ".join(
            f"delta{i + 1} stands at its extreme of the set, {limit_rad:.3f} rad, while by ground truth the "
            f"{WHEELS[i]} wheel goes {further_rad:.2f} rad further to that side"
            for i, (limit_rad, further_rad) in wheels.items()
        )
        + ": the angles are clipped there"
        for k, wheels in beyond.items()
    }


def _at_limit(own: Stretches, wheel: int, sign: float, limit_rad: float) -> Bools:
    """Mask (s,) of stretches in which a steering angle stands at an extreme."""
    near = sign * own.steering[..., wheel] > limit_rad - _AT_LIMIT_RAD
    return np.asarray(near.all(axis=0), dtype=np.bool_)


def _further_rad(own: Stretches, at: Bools, wheel: int, sign: float) -> float:
    """Angle by which a wheel goes beyond its steering angle in stretches `at` (s,), where it goes as far."""
    if np.count_nonzero(at) < _AT_LIMIT:
        return 0.0
    size = np.log(np.abs(own.moved[at, wheel]) / np.maximum(np.abs(own.rolled[at, wheel]), 1e-9))
    as_far = abs(float(np.median(size))) < _AS_FAR
    return float(np.median(sign * own.off_rad[at, wheel])) if as_far else 0.0


def _drifts(every: Sequence[Stretches | None]) -> str:
    """The steering angle that alone turns away from the way of its wheel in most recordings; else empty."""
    drifts = np.array([_drift_rad(own) for own in every if own is not None])
    if len(drifts) < _FEWEST:
        return ""
    middle = np.median(drifts, axis=0)
    i = int(np.argmax(np.abs(middle)))
    same = np.mean(drifts[:, i] * np.sign(middle[i]) > 0.5 * abs(middle[i]))
    others = float(np.abs(np.delete(middle, i)).max())
    if abs(middle[i]) < _DRIFT_RAD or others > _OTHERS * abs(middle[i]) or same < _MOST_OF:
        return ""
    return (
        f"in the course of a recording delta{i + 1} turns {abs(middle[i]):.2f} rad away from the way of the "
        f"{WHEELS[i]} wheel by ground truth, those of the others do not: its zero drifts"
    )


def _drift_rad(own: Stretches) -> Array:
    """Change (4,) of the errors of the steering angles from begin to end, by a line through all stretches."""
    since, weight = own.at_s / own.at_s[-1], np.minimum(np.abs(own.moved), np.abs(own.rolled))
    weight /= np.maximum(weight.sum(axis=0), 1e-9)
    run, off = (column - (weight * column).sum(axis=0) for column in (since[:, None], own.off_rad))
    return np.asarray((weight * run * off).sum(axis=0) / np.maximum((weight * run**2).sum(axis=0), 1e-9))


def _scaled(every: Sequence[Stretches | None], motions: Sequence[str]) -> str:
    """The scale of all steering angles about zero that their errors speak for; else empty.

    The errors are regressed on the steering angles and a zero for each wheel. Its standard error is that of
    motions: recordings of one motion have their slip in common.
    """
    rows = [
        (off, delta, i, motion)
        for own, motion in zip(every, motions, strict=True)
        if own is not None
        for i in range(len(WHEELS))
        for off, delta in _by_angle(own, i)
    ]
    names = {motion for *_, motion in rows}
    if len(names) < _MOTIONS:
        return ""
    off, delta = (np.array([row[k] for row in rows]) for k in (0, 1))
    wheels = np.eye(len(WHEELS))[[row[2] for row in rows]]
    base = delta - wheels @ np.linalg.lstsq(wheels, delta, rcond=None)[0]
    size = float(base @ base)
    slope = float(base @ off) / max(size, 1e-9)
    left = off - slope * delta
    left -= wheels @ np.linalg.lstsq(wheels, left, rcond=None)[0]
    by_motion = [sum(b * e for b, e, row in zip(base, left, rows, strict=True) if row[3] == m) for m in names]
    std = float(np.linalg.norm(by_motion)) / max(size, 1e-9) * np.sqrt(len(names) / (len(names) - 1))
    if abs(slope) < max(_SCALE, _STDS * max(std, _LEAST_STD)):
        return ""
    return (
        f"the wheels go by ground truth as if the steering angles (delta) were {1.0 + slope:.3f} times as "
        f"large (within {2.0 * max(std, _LEAST_STD):.3f}; {len(names)} motions, a zero for each wheel "
        "allowed): delta has another scale, or the heading of the ground truth differs between motions"
    )


def _by_angle(own: Stretches, wheel: int) -> list[tuple[float, float]]:
    """Median error and mean of a steering angle, in bins of the steering angle."""
    delta, off = own.middle_rad[:, wheel], own.off_rad[:, wheel]
    bins = np.round(delta / _BIN_RAD)
    return [
        (float(np.median(off[bins == one])), float(delta[bins == one].mean()))
        for one in np.unique(bins)
        if np.count_nonzero(bins == one) >= _IN_BIN
    ]
