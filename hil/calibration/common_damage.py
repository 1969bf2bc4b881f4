"""Refuses a set of recordings of which so many are left out that the rest cannot be trusted either.

What all checks leave out is added up. Where one cause spoils a whole set, the recordings that show it are
left out, and the parameters take the cause up in those that do not.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from hil.core.errors import DataError
from hil.datasets.recording_names import motion_of
from hil.datasets.wheel_log import Recording
from hil.datasets.wrong_signs import LEAVE_OUT

_DIRECTION = re.compile(r"_c?cw$")
_NUMBER = re.compile(r"(?<!\w)-?\d+(\.\d+)?")
"""A number that is no part of a word, as in the name of a column."""
_LOGS = ("odom", "abs")
"""Names of public pairs, which do not give the motion."""
_SEVERAL, _ALIKE, _SHARE = 2, 3, 4
"""Recordings of one motion, and recordings, at least one in four, that cannot be read for one reason."""


def check_what_is_left(
    recordings: Sequence[Recording], bad: Mapping[str, str], unusable: Mapping[str, str]
) -> dict[str, int]:
    """Refuse a set whose left-out recordings have, or seem to have, a cause in common.

    That is half of the recordings or more; or every recording of one kind of motion (circles of both
    directions are one kind), where there are at least two; or three recordings, and a quarter of all, that
    cannot be read for one reason.

    Args:
        recordings: those that could be read.
        bad: reasons why some of these are left out, by name.
        unusable: reasons why others could not be read, by file.

    Returns:
        Kinds of motion of which every recording is left out, with the number of their recordings.

    Raises:
        DataError: all recordings that are left out, with their reasons, the most frequent one first.
    """
    motions = {one.name: one.motion for one in recordings}
    gone, total = dict(unusable) | dict(bad), len(recordings) + len(unusable)
    lacking = _lacking([motion for name, motion in motions.items() if name not in bad], motions, gone)
    same = max(map(len, _alike(unusable)), default=0)
    causes = []
    if 2 * len(gone) >= total and gone:
        causes.append(f"{len(gone)} of {total} recordings are not usable")
    if kinds := [kind for kind, count in lacking.items() if count >= _SEVERAL]:
        causes.append(f"no recording of {' or '.join(kinds)} is left")
    if same >= _ALIKE and _SHARE * same >= total:
        causes.append(f"{same} of {total} recordings cannot be read for one reason")
    if causes:
        first, *others = (_in_words(group, gone) for group in _alike(gone))
        raise DataError(
            "",
            "; ".join((first, *causes, *(f"also: {other}" for other in others))),
            expected="a cause in single recordings; this one may be in all, also where it does not show",
            remedy=f"look for one cause, and correct it in all recordings; is it in these alone, {LEAVE_OUT}",
        )
    return lacking


def _lacking(used: Sequence[str], motions: Mapping[str, str], gone: Mapping[str, str]) -> dict[str, int]:
    """Kinds of motion of which every recording is left out, with the number of their recordings.

    Args:
        used: motions of the recordings that are used.
        motions: motions of those that could be read, by name.
        gone: reasons why recordings are left out, by name, or by file where they could not be read.
    """
    found: dict[str, int] = {}
    for name in gone:
        motion = motions.get(name) or motion_of(Path(name).name.split(".")[0])
        kind = _kind(motion)
        if motion not in _LOGS and kind not in map(_kind, used):
            found[kind] = found.get(kind, 0) + 1
    return found


def _kind(motion: str) -> str:
    """A motion without its direction of turning."""
    return _DIRECTION.sub("", motion)


def _alike(reasons: Mapping[str, str]) -> list[list[str]]:
    """Names of recordings with the same reason, but for numbers; the largest group first."""
    groups: dict[str, list[str]] = {}
    for name, why in reasons.items():
        groups.setdefault(_NUMBER.sub("#", why), []).append(name)
    return sorted(groups.values(), key=len, reverse=True)


def _in_words(names: Sequence[str], reasons: Mapping[str, str]) -> str:
    more = f" ({', '.join(Path(n).name for n in names[1:])} likewise)" if len(names) > 1 else ""
    return f"{names[0]}: {reasons[names[0]]}{more}"
