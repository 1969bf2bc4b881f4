"""Whether the coordinate frames of a bag hang together: one tree, or what is broken about it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

_TRANSFORMS = ("/tf", "/tf_static")
_ENOUGH = 20_000
"""Messages that are looked at: frames that appear later are rare, and bags may be long."""


def broken_frames(path: Path) -> tuple[str, ...]:
    """What is wrong with the frame tree of a bag, in words; nothing for a sound one, and for one without.

    Args:
        path: a rosbag2 folder or file that has been read before, so that it can be.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    parents: dict[str, set[str]] = {}
    used: dict[str, str] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
        for connection, _, raw in islice(bag.messages(), _ENOUGH):
            message: Any = bag.deserialize(raw, connection.msgtype)
            if connection.topic in _TRANSFORMS:
                for one in message.transforms:
                    parents.setdefault(one.child_frame_id, set()).add(one.header.frame_id)
            elif frame := getattr(getattr(message, "header", None), "frame_id", ""):
                used.setdefault(frame, connection.topic)
    return tuple(problems_of(parents, used)) if parents else ()


def problems_of(parents: Mapping[str, Iterable[str]], used: Mapping[str, str]) -> list[str]:
    """What is wrong with a tree.

    Args:
        parents: of each frame.
        used: frames that messages are given in, with the topic.
    """
    found = []
    for child, over in sorted(parents.items()):
        if len(names := sorted(over)) > 1:
            found.append(f"frame {child} hangs on {' and '.join(names)}: let one publisher send it")
    single = {child: min(over) for child, over in parents.items()}
    roots: dict[str, str] = {}
    for frame in {*single, *single.values()}:
        seen, at = [frame], frame
        while at in single and single[at] not in seen:
            at = single[at]
            seen.append(at)
        roots[frame] = at
        if at in single:
            roots[frame] = min(seen[seen.index(single[at]) :])
    loops = {root for root in roots.values() if root in single}
    found += [
        f"frame {frame} hangs on itself, in a loop: let each have one parent" for frame in sorted(loops)
    ]
    tops = sorted(set(roots.values()))
    if len(tops) > 1:
        trees = ", ".join(tops)
        found.append(f"{len(tops)} trees that nothing connects ({trees}): record the transform between them")
    found += [
        f"{topic} is given in frame {frame}, which no transform knows: record /tf_static from its start"
        for frame, topic in sorted(used.items())
        if frame not in roots
    ]
    return found
