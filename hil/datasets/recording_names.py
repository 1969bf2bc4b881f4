"""Names of recordings: the motion in them, and a suffix where two are alike."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hil.datasets.dataset import Recording

_REPETITION = re.compile(r"_[0-9]+$")


def motion_of(name: str) -> str:
    """Motion that a recording of this name shows: `line_x_2` is a repetition of `line_x`, by its number.

    Args:
        name: of the file or folder, without the part for its kind.
    """
    return _REPETITION.sub("", name) or name


def named_apart(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings, in order; those of one name get the folders that tell them apart, as `1/line_x_1`.

    Where the folder is the same as well, as for `odom_1.csv` and `odom_1.csv.gz`, the name is the file's.

    Args:
        recordings: each of files of its own.
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
    """Names for recordings that share one: as many folders, the last ones, as no two of them share."""
    files = [Path(os.path.abspath(one.sources[0])) for one in recordings]
    in_folder = Counter(file.parent for file in files)
    places = [
        (*file.parent.parts[1:], file.name if in_folder[file.parent] > 1 else one.name)
        for file, one in zip(files, recordings, strict=True)
    ]
    most = max(map(len, places))
    count = next(n for n in range(1, most + 1) if len({p[-n:] for p in places}) == len(places))
    return ["/".join(p[-count:]) for p in places]
