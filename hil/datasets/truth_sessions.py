"""Finds recordings whose ground truth has another heading or scale than other repetitions of their motion.

A body that is defined anew for each session, or zeros that are set anew, turn all recordings of a session. A
capture system that is calibrated anew scales them, as other wheels do. What makes single wheels differ is
found by `hil.datasets.unlike_repetitions`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hil.datasets.repetition_groups import Choice, Groups, against, by_motion, chosen
from hil.datasets.truth_deviations import STDS, typical
from hil.datasets.truth_fit import TruthFit
from hil.datasets.wheel_log import Recording
from hil.datasets.wheel_stretches import Stretches

_SESSION_RAD, _STD_RAD, _NEARER = 0.015, 0.01, 0.5
_SCALED, _MOTIONS = 0.014, 2
_OTHERWISE, _STRAIGHT_RAD = 0.15, 0.1
"""Scale from which on it is none of a session: positions of another body, say, which other checks name."""
_NOT_KNOWN = (
    "repetitions of its motion differ ({}), and no group is the larger one: which is right is not known"
)
_HEADING = (
    "the heading of its ground truth is {:.2f} rad off that of {} other repetitions, which agree, or all its "
    "steering angles are {:.2f} rad off theirs (a limit, zeros that were set anew)"
)
_HEADINGS = (
    "the heading of its ground truth, or all its steering angles, are {:.2f} rad off those of other "
    "repetitions: "
)
_SCALE = (
    "by ground truth it goes {:.3f} times as far, for the way of its wheels, as {} other repetitions of its "
    "motion, which agree: {}"
)
_SCALES = (
    "by ground truth it goes up to {:.1f} % further, for the way of its wheels, than other repetitions: "
)
_OF_ALL = "its positions have another scale, or its wheels other radii"
_OF_TURNS = (
    "only recordings that turn show it, straight ones of as many repetitions agree: its ground truth tracks "
    "another point, or its wheels have other places"
)

_Measured = Mapping[int, tuple[float, float]]
"""A value and its standard error, by index of a recording."""


def other_sessions(
    recordings: Sequence[Recording], fits: Sequence[TruthFit | None], centre_m: complex | None
) -> dict[int, str]:
    """Recordings with another heading than other repetitions of their motion, by what is said of them.

    Repetitions have the same tolerances and the same slip: their headings differ by less than 0.015 rad and
    four standard errors. Where they do not, the body or the steering zeros were set anew between them. See
    `hil.datasets.repetition_groups` for those that are kept; headings of other motions may tell.

    Args:
        recordings: recordings of one robot.
        fits: their fits.
        centre_m: tracked point, by which a circle shows its heading; None where no turn shows it.
    """
    measured = dict[int, tuple[float, float]]()
    for k, fit in enumerate(fits):
        if fit is None:
            continue
        own = (fit.heading_rad, fit.heading_std_rad)
        if centre_m is not None:
            own = (fit.heading_with(centre_m), fit.direction_std_rad)
        if own[1] < _STD_RAD:
            measured[k] = own
    motions = _groups(recordings, measured, _SESSION_RAD)
    single = [measured[k][0] for groups in motions.values() if len(groups) == 1 for k in groups[0]]
    choice = chosen(motions, _nearer_to(measured, single))
    out = dict[int, str]()
    names = [one.name for one in recordings]
    for k, kept in choice.kept.items():
        off_rad = measured[k][0] - _middle(measured, kept)
        out[k] = _HEADING.format(off_rad, len(kept), -off_rad)
    for k, groups in choice.open.items():
        out[k] = _HEADINGS.format(_spread(measured, groups)) + _NOT_KNOWN.format(against(groups, names))
    return out


def with_other_sessions(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; `contradictions` name distances unlike those of other repetitions.

    Repetitions have the same radii and the same slip: the medians of their scales differ by 0.01 at most, and
    by what noise of the ground truth makes of them. A difference of 0.014, and of four standard errors, in
    two motions is one of sessions: the larger group is kept, and none of two that are as large; in a single
    motion `notes` say so.
    """
    every = [Stretches.of(one) for one in recordings]
    measured = {
        k: (own.scale - 1.0, own.scale_std)
        for k, own in enumerate(every)
        if own is not None and own.scale is not None and abs(own.scale - 1.0) < _OTHERWISE
    }
    motions = _groups(recordings, measured, _SCALED)
    choice = chosen(motions, _nearer_to(measured, []))
    found = {recordings[k].motion for k in (*choice.kept, *choice.open)}
    cause = _OF_ALL if any(map(_is_straight, _members(recordings, found))) else _of_turns(recordings, motions)
    out, names = list(recordings), [one.name for one in recordings]
    noted = {groups[0][0] for groups in choice.open.values()}
    for k in sorted({*choice.kept, *choice.open}):
        if len(found) < _MOTIONS and k in choice.open and k not in noted:
            continue
        said, one = _of_scale(k, measured, choice, names, cause), out[k]
        out[k] = (
            one.contradicted(said)
            if len(found) >= _MOTIONS
            else replace(one, notes=(*one.notes, f"{one.name}: {said}"))
        )
    return out


def _of_scale(k: int, measured: _Measured, choice: Choice, names: Sequence[str], cause: str) -> str:
    if k in choice.kept:
        kept = choice.kept[k]
        return _SCALE.format(1.0 + measured[k][0] - _middle(measured, kept), len(kept), cause)
    groups = choice.open[k]
    by = _SCALES.format(100.0 * _spread(measured, groups))
    return f"{by}{cause}; {_NOT_KNOWN.format(against(groups, names))}"


def _members(recordings: Sequence[Recording], motions: set[str]) -> list[Recording]:
    return [one for one in recordings if one.motion in motions]


def _is_straight(one: Recording) -> bool:
    """Whether a recording turns by less than a tenth of a radian: a tracked point does not matter there."""
    return bool(np.ptp(one.truth_pose[:, 2]) < _STRAIGHT_RAD)


def _of_turns(recordings: Sequence[Recording], motions: Mapping[str, Groups]) -> str:
    """The cause where only turns differ: said where straight motions are repeated, and agree."""
    straight = [
        k for groups in motions.values() for group in groups for k in group if _is_straight(recordings[k])
    ]
    return _OF_TURNS if len(straight) > 1 else f"{_OF_ALL}, or it tracks another point"


def _groups(recordings: Sequence[Recording], measured: _Measured, least: float) -> dict[str, list[list[int]]]:
    """Groups of each motion, between which there are gaps of `least` and of four standard errors."""

    def differ(one: int, other: int) -> bool:
        (a, a_std), (b, b_std) = measured[one], measured[other]
        return abs(a - b) > max(least, STDS * float(np.hypot(a_std, b_std)))

    return by_motion(recordings, measured, differ)


def _nearer_to(measured: _Measured, others: Sequence[float]) -> Callable[[Groups], Sequence[int] | None]:
    """Chooses the group that is at most half as far from the typical value of other motions as any other."""

    def choose(groups: Groups) -> Sequence[int] | None:
        if len(others) < sum(map(len, groups)):
            return None
        off = {i: abs(_middle(measured, group) - typical(others)) for i, group in enumerate(groups)}
        first, second = sorted(off, key=lambda i: off[i])[:2]
        return groups[first] if off[first] < _NEARER * off[second] else None

    return choose


def _middle(measured: _Measured, group: Sequence[int]) -> float:
    return typical([measured[k][0] for k in group])


def _spread(measured: _Measured, groups: Groups) -> float:
    values = [measured[k][0] for group in groups for k in group]
    return max(values) - min(values)
