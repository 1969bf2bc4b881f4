"""Finds recordings whose ground truth has another heading than other repetitions of their motion.

A body that is defined anew for each session, or zeros that are set anew, turn all recordings of a session.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from hil.datasets.truth_deviations import STDS, typical
from hil.datasets.truth_fit import TruthFit
from hil.datasets.wheel_log import Recording

_SESSION_RAD, _STD_RAD = 0.015, 0.01


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
    by_motion = dict[str, list[tuple[float, float, int]]]()
    for k, (one, fit) in enumerate(zip(recordings, fits, strict=True)):
        if fit is None:
            continue
        own = (fit.heading_rad, fit.heading_std_rad)
        if centre_m is not None:
            own = (fit.heading_with(centre_m), fit.direction_std_rad)
        if own[1] < _STD_RAD:
            by_motion.setdefault(one.motion, []).append((*own, k))
    groups = [group for found in by_motion.values() if len(group := _groups(sorted(found))) > 1]
    if not groups:
        return {}
    kept = max(
        (0, -1),
        key=lambda end: (
            sum(len(group[end]) for group in groups),
            -abs(typical([heading for group in groups for heading, _, _ in group[end]])),
        ),
    )
    return {
        k: heading - typical([other for other, _, _ in group[kept]])
        for group in groups
        for part in group
        if part is not group[kept]
        for heading, _, k in part
    }


def _groups(found: Sequence[tuple[float, float, int]]) -> list[list[tuple[float, float, int]]]:
    """Headings in order, with standard errors, in groups between which there are gaps."""
    out = [[found[0]]]
    for before, one in itertools.pairwise(found):
        if one[0] - before[0] > max(_SESSION_RAD, STDS * float(np.hypot(before[1], one[1]))):
            out.append([])
        out[-1].append(one)
    return out
