"""Frame tree of a bag: its problems, in words."""

from collections.abc import Iterable, Mapping
from itertools import islice
from pathlib import Path

from hil.datasets.bag_messages import opened_bag

_TRANSFORMS = ("/tf", "/tf_static")
_ENOUGH = 20_000
"""Largest number of messages to scan: frames that appear later are rare, and bags may be long."""


def broken_frames(path: Path) -> tuple[str, ...]:
    """Problems of the frame tree of a bag, one message each; empty for a sound tree, or without one.

    Args:
        path: a rosbag2 folder or file that is known to be readable.
    """
    parents: dict[str, set[str]] = {}
    used: dict[str, str] = {}
    with opened_bag(path) as bag:
        for topic, _, message in islice(bag.messages(), _ENOUGH):
            if topic.name in _TRANSFORMS:
                for one in message.transforms:
                    parents.setdefault(one.child_frame_id, set()).add(one.header.frame_id)
            elif frame := getattr(getattr(message, "header", None), "frame_id", ""):
                used.setdefault(frame, topic.name)
    return tuple(problems_of(parents, used)) if parents else ()


def problems_of(parents: Mapping[str, Iterable[str]], used: Mapping[str, str]) -> list[str]:
    """Problems of a frame tree: frames with several parents, loops, separate trees, unknown frames.

    Args:
        parents: parents of each frame.
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
