"""Finds recordings whose ground truth or wheels are others than those of other repetitions of their motion.

A body that is defined anew for each session, or zeros that are set anew, turn all recordings of a session. A
capture system that is calibrated anew scales them. Another robot, or other wheels, change all wheels unlike.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hil.datasets.truth_deviations import STDS, typical
from hil.datasets.truth_fit import TruthFit
from hil.datasets.wheel_displacements import Complexes
from hil.datasets.wheel_log import Recording
from hil.datasets.wheel_stretches import Stretches

_SESSION_RAD, _STD_RAD = 0.015, 0.01
_SCALED, _MOTIONS = 0.014, 2
_OTHERWISE = 0.15
"""Scale from which on it is none of a session: positions of another body, say, which other checks name."""
_WHEELS_IN_MOST, _MANY = 0.0125, 5
_WHEELS, _ROBOTS, _DIFFERS, _MOST_WHEELS = 0.02, 0.1, 0.006, 3
_AS_MANY = (
    "for the way of their wheels its ground truth and that of other repetitions of its motion differ in "
    "scale by {:.1f} %, and there are as many of each: which positions are right is not known"
)

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


def with_other_sessions(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` name distances, or wheels, unlike those of other repetitions.

    Repetitions have the same radii and the same slip: the medians of their scales differ by 0.01 at most. A
    difference of 0.014 in two motions is one of sessions: the larger one is kept, and none of two that are as
    large; in a single motion `notes` say so. Wheels differ where three or four of them do in two motions, by
    0.02 (root mean square, rad and share of the way) and less than 0.1, or by 0.0125 in most of five motions.
    Which recordings are of the other robot is not known: all of these motions contradict.
    """
    every = [Stretches.of(one) for one in recordings]
    by_motion = dict[str, list[_Measured]]()
    for k, (one, own) in enumerate(zip(recordings, every, strict=True)):
        if own is not None and own.scale is not None and abs(own.scale - 1.0) < _OTHERWISE:
            by_motion.setdefault(one.motion, []).append((own.scale - 1.0, 0.0, k))
    others = _others(by_motion, _SCALED)
    of_session = len({recordings[k].motion for k in others}) >= _MOTIONS
    left = [None if own is None or (of_session and k in others) else own.off for k, own in enumerate(every)]
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
    size = float(np.median(np.abs(list(others.values())))) if others else 0.0
    if of_session and 2 * len(others) >= sum(
        len(by_motion[m]) for m in {recordings[k].motion for k in others}
    ):
        for k in {k for other in others for _, _, k in by_motion[recordings[other].motion]} - set(others):
            out[k] = replace(out[k], contradictions=(*out[k].contradictions, _AS_MANY.format(100.0 * size)))
            left[k] = None
    motions = _of_other_wheels(recordings, left)
    return [
        replace(one, contradictions=(*one.contradictions, motions[one.motion]))
        if off is not None and one.motion in motions
        else one
        for one, off in zip(out, left, strict=True)
    ]


def _of_other_wheels(recordings: Sequence[Recording], offs: Sequence[Complexes | None]) -> dict[str, str]:
    """What is wrong with motions, two at least, of which repetitions are by other wheels; else empty."""
    by_motion = dict[str, list[tuple[str, Complexes]]]()
    for one, off in zip(recordings, offs, strict=True):
        if off is not None:
            by_motion.setdefault(one.motion, []).append((one.name, off))
    apart = {motion: _apart(drives) for motion, drives in by_motion.items() if len(drives) > 1}
    far = [motion for motion, (by, _) in apart.items() if by > _WHEELS]
    usual = float(np.median([by for by, _ in apart.values()])) if len(apart) >= _MANY else 0.0
    if usual > _WHEELS_IN_MOST:
        far = [motion for motion, (by, _) in apart.items() if by > _WHEELS_IN_MOST]
    if len(far) < _MOTIONS:
        return {}
    return {
        motion: f"its wheels go otherwise than in other repetitions of its motion ({names}: by {by:.3f}, rad "
        "and share of the way), those of other motions as well: of two robots, or of wheels or zeros "
        "that were changed between sessions; calibrate each for itself"
        for motion, (by, names) in apart.items()
        if motion in far
    }


def _apart(drives: Sequence[tuple[str, Complexes]]) -> tuple[float, str]:
    """Largest difference of the wheels (4,) of two repetitions, root mean square, and their names."""
    found = (0.0, "")
    for (name, off), (other, its) in itertools.combinations(drives, 2):
        size = np.abs(off - its)
        by = float(np.sqrt(np.mean(size**2)))
        if found[0] < by < _ROBOTS and np.count_nonzero(size > _DIFFERS) >= _MOST_WHEELS:
            found = (by, f"{name}, {other}")
    return found


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
