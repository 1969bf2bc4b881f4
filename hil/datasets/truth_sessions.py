"""Finds recordings whose ground truth has another heading or scale than other repetitions of their motion.

A body that is defined anew for each session, or zeros that are set anew, turn all recordings of a session. A
capture system that is calibrated anew, or wheels that were changed, scale them.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hil.datasets.truth_deviations import STDS, typical
from hil.datasets.truth_fit import TruthFit
from hil.datasets.wheel_log import Recording
from hil.datasets.wheel_stretches import Stretches

_SESSION_RAD, _STD_RAD = 0.015, 0.01
_SCALED, _MOTIONS = 0.014, 2

_Measured = tuple[float, float, int]
"""A value, its standard error, and the index of its recording."""


def other_sessions(
    recordings: Sequence[Recording], fits: Sequence[TruthFit | None], centre_m: complex | None
) -> dict[int, float]:
    """Headings of recordings that differ from other repetitions of their motion, by the difference, rad.

    Repetitions have the same tolerances and the same slip: their headings differ by less than 0.015 rad and
    four standard errors. Where they do not, the body or the steering zeros were set anew between them. Of
    the lowest and the highest headings of all motions the more frequent are kept, or those nearer to 0.

    Args:
        recordings: recordings of one robot.
        fits: their fits.
        centre_m: tracked point, by which a circle shows its heading; None where no turn shows it.
    """
    by_motion = dict[str, list[_Measured]]()
    for k, (one, fit) in enumerate(zip(recordings, fits, strict=True)):
        if fit is None:
            continue
        own = (fit.heading_rad, fit.heading_std_rad)
        if centre_m is not None:
            own = (fit.heading_with(centre_m), fit.direction_std_rad)
        if own[1] < _STD_RAD:
            by_motion.setdefault(one.motion, []).append((*own, k))
    return _others(by_motion, _SESSION_RAD)


def with_other_scales(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` name distances that differ from those of other repetitions.

    Repetitions have the same radii and the same slip: the medians of their scales differ by 0.01 at most. A
    difference of 0.014 in two motions is one of sessions; in a single motion `notes` say so.
    """
    by_motion = dict[str, list[_Measured]]()
    for k, one in enumerate(recordings):
        own = Stretches.of(one)
        if own is not None and own.scale is not None:
            by_motion.setdefault(one.motion, []).append((own.scale - 1.0, 0.0, k))
    others = _others(by_motion, _SCALED)
    if not others:
        return list(recordings)
    of_session = len({recordings[k].motion for k in others}) >= _MOTIONS
    out = list(recordings)
    for k, off in others.items():
        said = (
            f"by ground truth it goes {1.0 + off:.3f} times as far, for the way of its wheels, as other "
            "repetitions of its motion: its positions have another scale, or its robot other wheels"
        )
        one = out[k]
        out[k] = (
            replace(one, contradictions=(*one.contradictions, said))
            if of_session
            else replace(one, notes=(*one.notes, f"{one.name}: {said}"))
        )
    return out


def _others(by_motion: Mapping[str, Sequence[_Measured]], least: float) -> dict[int, float]:
    """Recordings apart from those of their motion that are kept, by index, with the difference."""
    groups = [group for found in by_motion.values() if len(group := _groups(sorted(found), least)) > 1]
    if not groups:
        return {}
    kept = max(
        (0, -1),
        key=lambda end: (
            sum(len(group[end]) for group in groups),
            -abs(typical([value for group in groups for value, _, _ in group[end]])),
        ),
    )
    return {
        k: value - typical([other for other, _, _ in group[kept]])
        for group in groups
        for part in group
        if part is not group[kept]
        for value, _, k in part
    }


def _groups(found: Sequence[_Measured], least: float) -> list[list[_Measured]]:
    """Values in order, in groups between which there are gaps of `least` and of four standard errors."""
    out = [[found[0]]]
    for before, one in itertools.pairwise(found):
        if one[0] - before[0] > max(least, STDS * float(np.hypot(before[1], one[1]))):
            out.append([])
        out[-1].append(one)
    return out
