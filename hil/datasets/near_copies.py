"""Recognises one drive in two recordings although rows were cut, resampled or changed a little.

Two drives never have the same noise. Third differences of the ground truth leave little of the motion and
all of its noise; where those of two recordings agree at some lag, and so do the paths and the wheels, both
are of one drive. As separate recordings they would count twice and hide in a cross-validation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.core.geometry import Array
from hil.datasets.sampling import interpolate
from hil.datasets.wheel_displacements import Complexes
from hil.datasets.wheel_log import Recording

_GRID_S, _ORDER, _FEWEST = 0.02, 3, 200
_CLIPPED, _NOTHING = 4.0, 1e-12
_ALIKE, _OVERLAP_S = 0.3, 5.0
"""Least correlation of the noise, of two drives it is below 0.15; and the least time that both cover."""
_PATH_M, _HEADING_RAD, _WHEELS_RAD = 5e-4, 2e-3, 0.02
"""Root mean square differences up to which two paths and wheels are the same."""


@dataclass(frozen=True)
class _Noise:
    """Noise of one ground truth on a grid: its spectrum, of `size` samples, and its sum of squares."""

    spectrum: Complexes
    size: float


def without_near_copies(recordings: Sequence[Recording]) -> list[Recording]:
    """Drop recordings whose drive another one shows, and for longer; a repair of that one names them."""
    length = max((len(_grid(one)) for one in recordings if one.has_truth), default=0)
    noises = [_noise(one, 2 * length) for one in recordings]
    kept: list[int] = []
    copies = dict[int, list[int]]()
    for k in sorted(range(len(recordings)), key=lambda k: -len(recordings[k].t_s)):
        own = noises[k]
        twin = next(
            (
                other
                for other in kept
                if own is not None
                and (its := noises[other]) is not None
                and _same(recordings[k], recordings[other], own, its)
            ),
            None,
        )
        if twin is None:
            kept.append(k)
        else:
            copies.setdefault(twin, []).append(k)
    out = []
    for k in sorted(kept):
        one = recordings[k]
        more = {
            f"recording of the same drive left out, {recordings[c].name}": 1
            for c in sorted(copies.get(k, []))
        }
        out.append(replace(one, repairs={**one.repairs, **more}) if more else one)
    return out


def _grid(one: Recording) -> Array:
    return np.arange(one.truth_t_s[0], one.truth_t_s[-1], _GRID_S)


def _noise(one: Recording, count: int) -> _Noise | None:
    """Noise of a recording; None where it has too few rows, or none."""
    if not one.has_truth or one.of_twist or len(one.truth_t_s) < _FEWEST or len(_grid(one)) < _FEWEST:
        return None
    values = np.diff(interpolate(_grid(one), one.truth_t_s, one.truth_pose), n=_ORDER, axis=0)
    usual = np.median(np.abs(values), axis=0)
    if np.any(usual < _NOTHING):
        return None
    values = np.clip(values / usual, -_CLIPPED, _CLIPPED)
    return _Noise(np.fft.rfft(values, count, axis=0), float((values**2).sum()))


def _same(one: Recording, other: Recording, own: _Noise, its: _Noise) -> bool:
    """Whether two recordings are of one drive."""
    alike = np.fft.irfft((own.spectrum * np.conj(its.spectrum)).sum(axis=1))
    lag = int(np.argmax(alike))
    if alike[lag] < _ALIKE * min(own.size, its.size):
        return False
    lag -= len(alike) if lag > len(alike) // 2 else 0
    later_s = float(one.truth_t_s[0] - other.truth_t_s[0]) + lag * _GRID_S
    begin_s = max(one.truth_t_s[0], other.truth_t_s[0] + later_s, one.t_s[0], other.t_s[0] + later_s)
    end_s = min(one.truth_t_s[-1], other.truth_t_s[-1] + later_s, one.t_s[-1], other.t_s[-1] + later_s)
    if end_s - begin_s < _OVERLAP_S:
        return False
    at_s = np.arange(begin_s, end_s, _GRID_S)
    x, y, turn = (
        interpolate(at_s, one.truth_t_s, one.truth_pose)
        - interpolate(at_s - later_s, other.truth_t_s, other.truth_pose)
    ).T
    wheels = interpolate(at_s, one.t_s, one.wheel_angle_rad) - interpolate(
        at_s - later_s, other.t_s, other.wheel_angle_rad
    )
    apart_m, apart_rad = float(np.sqrt(np.mean(x**2 + y**2))), float(np.std(turn))
    return apart_m < _PATH_M and apart_rad < _HEADING_RAD and float(wheels.std(axis=0).max()) < _WHEELS_RAD
