"""Finds errors of ground truth that no clock, heading or centre explains: skewed axes, drift, uneven clocks.

`hil.datasets.truth_fit` measures them. They cannot be corrected: what a set has in common, or one recording
has alone, is named as what it is.
"""

from collections.abc import Sequence

import numpy as np

from hil.datasets.truth_fit import TruthFit

STDS, SCALE_STD = 4.0, 0.012
_DRIFT_RAD_S, _DRIFT_STD_RAD_S, _SKEW, _SKEW_STD = 1.5e-3, 2.5e-3, 0.01, 0.01
_WOBBLE_S, _WOBBLE_STDS = 0.04, 2.0
_SMOOTH_S2, _SMOOTH_STD_S2 = 0.15**2, 0.07**2
_DRIFT_ALONE_RAD_S, _SKEW_ALONE, _SCALE_ALONE = 2e-3, 0.015, 0.04
"""Bounds for a recording that differs from the others of its set."""


def beyond(known: Sequence[TruthFit]) -> tuple[str, ...]:
    """What is wrong with the ground truth of a set that no clock, heading or centre explains, in words."""
    smooth_s2 = significant(
        [(complex(fit.smooth_s2), fit.smooth_std_s2) for fit in known], _SMOOTH_S2, _SMOOTH_STD_S2
    ).real
    if smooth_s2 > 0.0:
        return (
            "its ground truth is smoother than the motion of the wheels, spread over "
            f"{np.sqrt(smooth_s2):.2f} s or more (standard deviation), and so wrong wherever the motion "
            "changes: it was filtered, averaged, or filled in between fewer poses; take poses as measured",
        )
    out = []
    skew = significant([(fit.skew, fit.skew_std) for fit in known], _SKEW, _SKEW_STD)
    drift_rad_s = significant(
        [(complex(fit.drift_rad_s), fit.drift_std_rad_s) for fit in known], _DRIFT_RAD_S, _DRIFT_STD_RAD_S
    ).real
    uneven_s = [fit.wobble_s for fit in known if uneven(fit)]
    if skew:
        out.append(
            f"lengths in its ground truth depend on their direction, by {200 * abs(skew):.1f} % (paths on "
            "which the body turns): one axis has another scale, or the axes are not at right angles; "
            "calibrate the capture system again"
        )
    if drift_rad_s:
        out.append(
            f"the heading of its ground truth drifts by {drift_rad_s:.4f} rad/s from that of the wheels, at "
            "rest as well; look at what gives the heading (a gyroscope, markers that come loose)"
        )
    if 2 * len(uneven_s) > len(known):
        out.append(
            f"the clock of its ground truth runs unevenly, by about {typical(uneven_s):.2f} s in a "
            "recording (neither a delay nor a stretch); stamp both logs by one clock"
        )
    return tuple(out)


def uneven(fit: TruthFit) -> bool:
    """Whether the clock of a ground truth may step or bend: neither a delay nor a stretch."""
    return fit.wobble_s > max(_WOBBLE_S, _WOBBLE_STDS * fit.wobble_std_s)


def beyond_alone(fit: TruthFit, typical_scale: float) -> tuple[str, ...]:
    """What is wrong with the ground truth of one recording that no clock, heading or centre explains.

    Args:
        fit: fit of the recording.
        typical_scale: distance by ground truth over distance by wheels in most recordings of its set.
    """
    out, off = [], fit.scale - typical_scale
    if _clear(fit.skew, 2.0 * fit.skew_std, _SKEW_ALONE, _SKEW_STD):  # slip is a skew where a path bends once
        out.append(
            f"lengths in its ground truth depend on their direction, by {200 * abs(fit.skew):.1f} %: one "
            "axis has another scale, or the axes are not at right angles"
        )
    elif _clear(off, fit.scale_std, _SCALE_ALONE, SCALE_STD):
        out.append(f"distances in its ground truth are {1.0 + off:.3f} times those of the other recordings")
    if _clear(fit.drift_rad_s, fit.drift_std_rad_s, _DRIFT_ALONE_RAD_S, _DRIFT_STD_RAD_S):
        out.append(f"the heading of its ground truth drifts by {fit.drift_rad_s:.4f} rad/s from the wheels'")
    if _clear(fit.wobble_s, fit.wobble_std_s, _WOBBLE_S, _WOBBLE_S):
        out.append(
            f"the clock of its ground truth runs unevenly, by {fit.wobble_s:.2f} s; cut it at the step"
        )
    return tuple(out)


def _clear(value: complex, std: float, least: float, most_std: float) -> bool:
    """Whether a value is above `least` and four standard errors, and its standard error below `most_std`."""
    return std < most_std and abs(value) > max(least, STDS * std)


def significant(measured: Sequence[tuple[complex, float]], least: float, std: float) -> complex:
    """Mean, by weight, of values known to `std`; 0 where it is below `least` or four standard errors."""
    weights = [(value, own**-2) for value, own in measured if 0.0 < own < std]
    if not weights:
        return 0j
    total = sum(weight for _, weight in weights)
    middle = complex(*(_middle([part(v) for v, _ in weights]) for part in (np.real, np.imag)))
    mean = sum(value * weight for value, weight in weights) / total
    sure = min(abs(mean), abs(middle)) >= max(least, STDS * total**-0.5)
    return mean if sure else 0j


def _middle(values: Sequence[float]) -> float:
    """The median; of an even number of values that of the middle two that is nearer to 0."""
    in_order = sorted(values)
    return float(min(in_order[(len(values) - 1) // 2], in_order[len(values) // 2], key=abs))


def typical(values: Sequence[float]) -> float:
    """The lower median; 0 of nothing."""
    return float(sorted(values)[(len(values) - 1) // 2]) if values else 0.0
