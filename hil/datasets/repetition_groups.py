"""Groups of repetitions of a motion that measured the same, and which of these groups is to be kept.

Repetitions have the same tolerances and the same slip. Where they measure something else, something was
changed between them. The larger group is kept. Where none is larger, the repetitions of other motions may
tell; else nothing says which is right.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from hil.datasets.wheel_log import Recording

Groups = Sequence[Sequence[int]]
"""Indices of the recordings of a motion, by group."""


@dataclass(frozen=True)
class Choice:
    """Groups that are kept, and those that are not.

    Attributes:
        kept: members of the kept group of their motion, by index of a recording that is not in it.
        open: all groups of a motion of which none is known to be right, by index of each of its recordings.
    """

    kept: Mapping[int, Sequence[int]]
    open: Mapping[int, Groups]


def grouped(members: Sequence[int], differ: Callable[[int, int], bool]) -> list[list[int]]:
    """Members in groups of which no two differ; each joins the largest that it may."""
    out = list[list[int]]()
    for k in members:
        same = [group for group in out if not any(differ(k, other) for other in group)]
        if same:
            max(same, key=len).append(k)
        else:
            out.append([k])
    return out


def by_motion(
    recordings: Sequence[Recording], members: Iterable[int], differ: Callable[[int, int], bool]
) -> dict[str, list[list[int]]]:
    """Groups of the repetitions of each motion.

    Args:
        recordings: all recordings.
        members: indices of those that are grouped.
        differ: whether two of them measured something else.
    """
    motions = dict[str, list[int]]()
    for k in members:
        motions.setdefault(recordings[k].motion, []).append(k)
    return {motion: grouped(own, differ) for motion, own in motions.items()}


def chosen(motions: Mapping[str, Groups], nearer: Callable[[Groups], Sequence[int] | None]) -> Choice:
    """Choose a group of each motion that has several.

    Over all these motions the largest groups must hold more recordings than the others do. Where they do
    not, or the largest of a motion is as large as another one, `nearer` may tell.

    Args:
        motions: groups by motion.
        nearer: the group that other motions speak for; None where they do not.
    """
    several = {motion: groups for motion, groups in motions.items() if len(groups) > 1}
    total = sum(len(group) for groups in several.values() for group in groups)
    most = sum(max(map(len, groups)) for groups in several.values())
    kept, unknown = dict[int, Sequence[int]](), dict[int, Groups]()
    for groups in several.values():
        first, second = sorted(groups, key=len, reverse=True)[:2]
        best = first if 2 * most > total and len(first) > len(second) else nearer(groups)
        for group in groups:
            if best is None:
                unknown |= dict.fromkeys(group, groups)
            elif group is not best:
                kept |= dict.fromkeys(group, best)
    return Choice(kept, unknown)


def against(groups: Groups, names: Sequence[str]) -> str:
    """The groups in words."""
    return " against ".join(", ".join(names[k] for k in group) for group in groups)
