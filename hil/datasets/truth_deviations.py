"""Finds errors of ground truth that no clock, heading or centre explains: skewed axes, drift, uneven clocks.

`hil.datasets.truth_fit` measures them. They cannot be corrected: what a set has in common, or one recording
has alone, is named as what it is.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.datasets.truth_fit import TruthFit
from hil.datasets.truth_moves import DRIFT, SKEW, SMOOTHED, UNEVEN

STDS, SCALE_STD = 4.0, 0.012
_SMOOTHED_S2, _SMOOTHED_STD_S2 = 0.15**2, 0.07**2
_DRIFT_RAD_S, _DRIFT_STD_RAD_S, _SKEW, _SKEW_STD = 4e-4, 2.5e-3, 4e-3, 0.01
_TURNS, _TURNS_STD, _CLEARLY = 5e-3, 0.02, 4.0
_UNEVEN_S, _UNEVEN_STDS = 0.04, 2.0
_CENTRE_M = 6e-3
_WHEEL_S, _WHEEL_STD_S, _WHEEL_ALONE_STD_S = 0.03, 0.1, 0.03
_DRIFT_ALONE_RAD_S, _SKEW_ALONE, _SCALE_ALONE = 1e-3, 6e-3, 0.04
"""Bounds for a recording that differs from the others of its set."""
_ALIKE, _ALONE = 0.8, 3.0
_TRANSIENT = (SMOOTHED, UNEVEN, *WHEELS)

_SMOOTHER = (
    "its ground truth is smoother than the motion of the wheels, spread over {:.2f} s or more (standard "
    "deviation), and so wrong wherever the motion changes: it was filtered, averaged, or filled in between "
    "fewer poses; take poses as measured"
)
_UNEVENLY = (
    "its ground truth and its wheels part in time by about {:.2f} s, otherwise in each part of a recording "
    "(neither a delay nor a stretch): a clock that runs unevenly, rows that were lost or held, and wheel "
    "angles whose error depends on the speed look alike; compare the stamps of both logs"
)
_LATE = (
    "its columns of the {} wheel (phi, delta) come {:.2f} s or more {} than those of the other wheels: stamp "
    "all wheels by one clock"
)


def beyond(known: Sequence[TruthFit]) -> tuple[str, ...]:
    """What is wrong with a set that no clock, heading or centre explains, in words."""
    if not known:
        return ()
    if transient := _transient(known):
        return (transient,)
    out = []
    skew, drift_rad_s = (
        _common(known, SKEW, _SKEW, _SKEW_STD),
        _common(known, DRIFT, _DRIFT_RAD_S, _DRIFT_STD_RAD_S),
    )
    further = _turns_further(known)
    if further and drift_rad_s.any():
        steady, by_turn = _drift_misfits(known, float(drift_rad_s[0]))
        further = 0.0 if by_turn > _CLEARLY * steady else further
        drift_rad_s = np.zeros(1) if steady > _CLEARLY * by_turn else drift_rad_s
    if further:
        out.append(
            f"the heading of its ground truth turns {1.0 / (1.0 - further):.3f} times as far as its path "
            "(curves and circles of the set): theta has another scale; its wheels' distances would take the "
            "error up. Look at the unit of theta and at how it is computed"
        )
    if skew.any():
        out.append(
            f"lengths in its ground truth depend on their direction, by {200 * np.linalg.norm(skew):.1f} % "
            "(paths on which the body turns): one axis has another scale, or the axes are not at right "
            "angles; calibrate the capture system again"
        )
    if drift_rad_s.any():
        out.append(
            f"the heading of its ground truth drifts by {drift_rad_s[0]:.4f} rad/s from that of the wheels, "
            "at rest as well; look at what gives the heading (a gyroscope, markers that come loose)"
        )
    return tuple(out)


def near_centre(centre_m: complex, by_turns: int) -> tuple[str, ...]:
    """Note on a tracked point that is too near the middle of the wheels to be told from what wheels do.

    Radii 2.5 % and steering zeros 2 deg apart shift the middle of a turn by up to 5.5 mm.

    Args:
        centre_m: tracked point (x + iy) by turns.
        by_turns: number of recordings that show it.
    """
    if abs(centre_m) < _CENTRE_M:
        return ()
    return (
        f"in turns ({by_turns} recordings) the ground truth tracks a point {1e3 * centre_m.real:.0f} mm "
        f"ahead and {1e3 * centre_m.imag:.0f} mm to the left of the middle of the wheels: either its body is "
        "set so, or radii and steering zeros of the wheels shift the middle of a turn; recordings cannot "
        "tell these apart. Nothing is corrected, and the parameters take it up: measure where the pivot is",
    )


def _turns_further(known: Sequence[TruthFit]) -> float:
    """Share of its turns by which the heading turns further than the path; 0 where they agree.

    In a turn on the spot there is no path, and the wheels' distances explain another scale as well.
    """
    shares = [
        (complex(fit.heading_beyond_path), fit.causes[DRIFT].std / abs(fit.turns_rad_s))
        for fit in known
        if fit.turns_rad_s
    ]
    return significant(shares, _TURNS, _TURNS_STD).real


def _drift_misfits(known: Sequence[TruthFit], steady_rad_s: float) -> tuple[float, float]:
    """Squared misfit of the drifts by a steady one, and by one in proportion to the turns of each path."""
    drift, std, turns = np.array(
        [(fit.causes[DRIFT].values[0], fit.causes[DRIFT].std, fit.turns_rad_s) for fit in known]
    ).T
    share = float((drift * turns / std**2).sum() / (turns**2 / std**2).sum())
    misfits = [float((((drift - by) / std) ** 2).sum()) for by in (steady_rad_s, share * turns)]
    return misfits[0], misfits[1]


def _transient(known: Sequence[TruthFit]) -> str:
    """What is wrong where the motion changes; empty where nothing is."""
    likely, alike = _likely({name: sum(fit.causes[name].gain for fit in known) for name in _TRANSIENT})
    if likely == SMOOTHED:
        smoothed_s2 = _common(known, SMOOTHED, _SMOOTHED_S2, _SMOOTHED_STD_S2)[0]
        return _SMOOTHER.format(np.sqrt(smoothed_s2)) if smoothed_s2 > 0.0 else ""
    if likely == UNEVEN:
        uneven_s = [fit.causes[UNEVEN].size for fit in known if uneven(fit)]
        return _UNEVENLY.format(typical(uneven_s)) if 2 * len(uneven_s) > len(known) else ""
    late_s = _common(known, likely, _WHEEL_S, _WHEEL_STD_S)[0]
    return _late(alike, late_s) if late_s and len(alike) < len(WHEELS) else ""


def _likely(gains: Mapping[str, float]) -> tuple[str, list[str]]:
    """The likeliest cause, and the wheels that explain nearly as much.

    One wheel that is late is an average of two times as well, and makes the clock look uneven; neither of
    these looks like one wheel. They count where they explain three times as much as any wheel.
    """
    wheel, common = (max(names, key=lambda name: gains[name]) for names in (WHEELS, (SMOOTHED, UNEVEN)))
    likely = common if gains[common] > _ALONE * gains[wheel] else wheel
    return likely, [name for name in WHEELS if gains[name] > _ALIKE * gains[likely]]


def _late(wheels: Sequence[str], late_s: float) -> str:
    word = "later" if late_s > 0.0 else "earlier"
    return _LATE.format(" or ".join(wheels), abs(late_s), word)


def uneven(fit: TruthFit) -> bool:
    """Whether the clock of a ground truth may step or bend: neither a delay nor a stretch."""
    found = fit.causes[UNEVEN]
    return found.size > max(_UNEVEN_S, _UNEVEN_STDS * found.std)


def beyond_alone(fit: TruthFit, typical_scale: float) -> tuple[str, ...]:
    """What is wrong with one recording that no clock, heading or centre explains.

    Args:
        fit: fit of the recording.
        typical_scale: distance by ground truth over distance by wheels in most recordings of its set.
    """
    if transient := _transient_alone(fit):
        return (transient,)
    out, skew, drift = list[str](), fit.causes[SKEW], fit.causes[DRIFT]
    off = min((fit.scale - typical_scale, fit.scale_of_middle - typical_scale), key=abs)
    if _clear(skew.size, 2.0 * skew.std, _SKEW_ALONE, _SKEW_STD):  # slip is a skew where a path bends once
        out.append(
            f"lengths in its ground truth depend on their direction, by {200 * skew.size:.1f} %: one "
            "axis has another scale, or the axes are not at right angles"
        )
    elif _clear(off, fit.scale_std, _SCALE_ALONE, SCALE_STD):
        out.append(f"distances in its ground truth are {1.0 + off:.3f} times those of the other recordings")
    if _clear(drift.size, drift.std, _DRIFT_ALONE_RAD_S, _DRIFT_STD_RAD_S):
        out.append(f"the heading of its ground truth drifts by {drift.values[0]:.4f} rad/s from the wheels'")
    return tuple(out)


def _transient_alone(fit: TruthFit) -> str:
    """What is wrong with one recording where its motion changes; empty where nothing is."""
    likely, alike = _likely({name: fit.causes[name].gain for name in _TRANSIENT})
    found = fit.causes[likely]
    if likely == SMOOTHED and found.values[0] > 0.0:
        clear = _clear(found.size, found.std, _SMOOTHED_S2, _SMOOTHED_STD_S2)
        return _SMOOTHER.format(np.sqrt(found.size)) if clear else ""
    if likely == UNEVEN and _clear(found.size, found.std, _UNEVEN_S, _UNEVEN_S):
        return (
            f"its ground truth and its wheels part in time by {found.size:.2f} s in its course: a clock that "
            "runs unevenly, or rows that were lost; cut it at the step"
        )
    if (
        likely in WHEELS
        and len(alike) < len(WHEELS)
        and _clear(found.size, found.std, _WHEEL_S, _WHEEL_ALONE_STD_S)
    ):
        return _late(alike, float(found.values[0]))
    return ""


def _clear(value: float, std: float, least: float, most_std: float) -> bool:
    """Whether a value is above `least` and four standard errors, and its standard error below `most_std`."""
    return std < most_std and abs(value) > max(least, STDS * std)


def _common(known: Sequence[TruthFit], name: str, least: float, std: float) -> Array:
    """Coefficients of a cause that recordings have in common; zeros where it is not significant."""
    found = [fit.causes[name] for fit in known]
    if len(found[0].values) == 1:
        return np.array([significant([(complex(one.values[0]), one.std) for one in found], least, std).real])
    both = significant([(complex(*one.values), one.std) for one in found], least, std)
    return np.array([both.real, both.imag])


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
