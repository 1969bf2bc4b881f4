"""Names of recordings: the motion in the name, and a prefix where two names are equal."""

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hil.datasets.wheel_log import Recording

MOTIONS = ("line_x", "line_y", "circle_ccw", "circle_cw", "rotation_ccw", "rotation_cw")
"""The paper's six motions."""
_REPETITION = re.compile(r"_[0-9]+$")


def motion_of(name: str) -> str:
    """Motion in a recording's name, without the repetition number: `line_x_2` -> `line_x`.

    Args:
        name: name of the file or folder, without suffix.
    """
    return _REPETITION.sub("", name) or name


def repetition_of(name: str) -> str:
    """Repetition in a recording's name: `line_x_2` -> `_2`; empty where it has none."""
    found = _REPETITION.search(name)
    return found.group() if found else ""


def named_apart(recordings: Sequence[Recording]) -> list[Recording]:
    """Make the names unique: equal names get their distinguishing folders, as `1/line_x_1`.

    Where the folder is equal as well, as for `odom_1.csv` and `odom_1.csv.gz`, the file name is used.

    Args:
        recordings: recordings, each from its own files.
    """
    alike: dict[str, list[int]] = {}
    for k, one in enumerate(recordings):
        alike.setdefault(one.name, []).append(k)
    out = list(recordings)
    for group in alike.values():
        if len(group) > 1:
            for k, name in zip(group, _apart([recordings[k] for k in group]), strict=True):
                out[k] = replace(recordings[k], name=name)
    return out


def _apart(recordings: Sequence[Recording]) -> list[str]:
    """Names for recordings with one name: as many trailing folders as make them unique."""
    files = [Path(os.path.abspath(one.sources[0])) for one in recordings]
    in_folder = Counter(file.parent for file in files)
    places = [
        (*file.parent.parts[1:], file.name if in_folder[file.parent] > 1 else one.name)
        for file, one in zip(files, recordings, strict=True)
    ]
    most = max(map(len, places))
    count = next(n for n in range(1, most + 1) if len({p[-n:] for p in places}) == len(places))
    return ["/".join(p[-count:]) for p in places]
