"""Draft of a `--topics` file, guessed from the names, types and frames of a bag.

What cannot be guessed stands in a comment: only the user knows the robot. Types decide first, then words in
the names of topics, joints and frames.
"""

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from hil.datasets.bag_messages import opened_bag
from hil.datasets.bag_sensors import STATIC
from hil.datasets.rosbag import TYPES

_ENOUGH = 20_000
"""Largest number of messages to read."""
_TRUTH = ("mocap", "truth", "vicon", "optitrack", "vrpn", "qualisys", "natnet", "motive", "gt")
_CAMERA = (
    "vio",
    "camera",
    "tracker",
    "t265",
    "visual",
    "vslam",
    "slam",
    "zed",
    "realsense",
    "oak",
    "rtabmap",
)
_STEER = ("steer", "delta", "swivel", "azimuth", "pivot", "caster", "turn")
_BODIES = ("base_link", "base_footprint", "body", "base", "chassis")
_CORNERS = (("f", "l"), ("b", "l"), ("b", "r"), ("f", "r"))
_SIDES = {"front": "f", "rear": "b", "back": "b", "left": "l", "right": "r", "hind": "b"}
_SHORT = {
    **dict.fromkeys(("fl", "lf"), ("f", "l")),
    **dict.fromkeys(("bl", "lb", "rl", "lr", "hl"), ("b", "l")),
    **dict.fromkeys(("br", "rb", "rr", "hr"), ("b", "r")),
    **dict.fromkeys(("fr", "rf"), ("f", "r")),
}
"""Corners by two letters, of which r before l or r means rear."""
_LITTLE_M_S2 = 3.0


@dataclass
class _Bag:
    """What a bag holds: topics with their types, and what their first messages say."""

    kinds: dict[str, str] = field(default_factory=dict)
    joints: dict[str, dict[str, None]] = field(default_factory=dict)
    frames: dict[str, str] = field(default_factory=dict)
    children: dict[str, str] = field(default_factory=dict)
    forces: dict[str, list[float]] = field(default_factory=dict)
    static: dict[str, None] = field(default_factory=dict)

    def add(self, name: str, message: Any) -> None:
        """Note what a message says of frames, joints and gravity."""
        kind = self.kinds[name]
        if name == STATIC:
            for one in message.transforms:
                self.static.update({one.header.frame_id: None, one.child_frame_id: None})
        elif kind in TYPES["wheels"]:
            self.joints.setdefault(name, {}).update(dict.fromkeys(message.name))
        else:
            self.frames.setdefault(name, message.header.frame_id)
            self.children.setdefault(name, getattr(message, "child_frame_id", ""))
            if kind in TYPES["imu"]:
                a = message.linear_acceleration
                self.forces.setdefault(name, []).append((a.x**2 + a.y**2 + a.z**2) ** 0.5)


def draft(path: Path) -> str:
    """Text of a draft of the `--topics` file of a bag.

    Args:
        path: a rosbag2 folder, or one of its storage files.

    Raises:
        DataError: the bag cannot be read.
    """
    bag = _Bag()
    known = {kind for kinds in TYPES.values() for kind in kinds}
    with opened_bag(path) as opened:
        there = {topic.name: topic.kind for topics in opened.topics for topic in topics}
        bag.kinds = {n: kind for n, kind in sorted(there.items()) if kind in known or n == STATIC}
        for topic, _, message in islice(opened.messages(bag.kinds), _ENOUGH):
            bag.add(topic.name, message)
    bag.kinds.pop(STATIC, None)
    used, tables = _tables(bag)
    body = next((one for one in _BODIES if one in bag.static), "")
    head = ["schema = 2", *([f"body_frame = {_text(body)}"] if body and body != "base_link" else [])]
    left = [f"# not used: {name} ({kind})" for name, kind in bag.kinds.items() if name not in used]
    return "\n".join([f"# Draft for {path.name}: look at every line.", *head, *tables, *left, ""])


def _tables(bag: _Bag) -> tuple[set[str], list[str]]:
    """Topics that tables name, and the lines of these tables."""
    lines, used = [], set[str]()
    wheels = max(bag.joints, key=lambda name: len(_corners(bag.joints[name])[1]), default="")
    drive, steer = _corners(bag.joints.get(wheels, ()))
    twists = _by_words(bag, "odometry", (), (*_TRUTH, *_CAMERA))
    if len(drive) == len(steer) == len(_CORNERS):
        used.add(wheels)
        lines += ["[wheels]", f"topic = {_text(wheels)}"]
        lines += [f"{key} = {_text(names)}" for key, names in (("drive", drive), ("steer", steer))]
    elif twists:
        used.add(twists[0])
        lines += ["[odometry]", f"topic = {_text(twists[0])}"]
    else:
        lines += ["# [wheels] or [odometry]: neither four driven and steered joints nor a twist was found"]
    truth = [name for name in _by_words(bag, "truth", _TRUTH) if name not in used]
    lines += _posed("truth", truth, used)
    imus = _by_words(bag, "imu", ())
    for imu in imus[:1]:
        used.add(imu)
        norm = sorted(bag.forces[imu])[len(bag.forces[imu]) // 2] if bag.forces.get(imu) else 9.81
        gravity = "removed" if norm < _LITTLE_M_S2 else "in_force"
        lines += ["[imu]", f"topic = {_text(imu)}", _mount(bag, bag.frames.get(imu, ""))]
        lines += [f'gravity = "{gravity}"  # {norm:.2f} m/s^2']
    for camera in [name for name in _by_words(bag, "tracker", _CAMERA) if name not in used][:1]:
        used.add(camera)
        frame = bag.children.get(camera, "")
        eyes = [one for one in bag.static if _has(one, _CAMERA) and one != bag.frames.get(camera)]
        frame = eyes[0] if not frame and len(eyes) == 1 else frame
        lines += ["[tracker]", f"topic = {_text(camera)}", _mount(bag, frame)]
    return used, lines


def _posed(table: str, names: list[str], used: set[str]) -> list[str]:
    if not names:
        return [f"# [{table}]: no topic has a name of ground truth; without it there is no error table"]
    used.add(names[0])
    return [f"[{table}]", f"topic = {_text(names[0])}"]


def _by_words(bag: _Bag, table: str, words: Iterable[str], others: Iterable[str] = ()) -> list[str]:
    """Topics of a table's types whose names hold one of the words, if given, and none of the others."""
    names = [name for name, kind in bag.kinds.items() if kind in TYPES[table]]
    kept = [name for name in names if not _has(name, others)]
    return [name for name in kept if _has(name, words)] if words else kept


def _has(name: str, words: Iterable[str]) -> bool:
    parts = set(re.split(r"[^a-z0-9]+", name.lower()))
    return any(word in parts or (len(word) > 3 and word in name.lower()) for word in words)


def _mount(bag: _Bag, frame: str) -> str:
    """Line with the frame of a sensor where `/tf_static` has it, else with a mount to be filled in."""
    if frame in bag.static:
        return f"frame = {_text(frame)}"
    return "mount_rotation_wxyz = [1.0, 0.0, 0.0, 0.0]  # as it lies on the robot"


def _corners(names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Drive and steering joints, each in the order FL, BL, BR, FR, as far as their names say."""
    found: Mapping[bool, dict[tuple[str, str], str]] = {False: {}, True: {}}
    for name in names:
        if corner := _corner(name):
            found[any(word in name.lower() for word in _STEER)].setdefault(corner, name)
    ordered = [[group[c] for c in _CORNERS if c in group] for group in (found[False], found[True])]
    return ordered[0], ordered[1]


def _corner(name: str) -> tuple[str, str] | None:
    """Corner of a joint: front or back, left or right."""
    plain = name.lower()
    seen = {letter for word, letter in _SIDES.items() if word in plain}
    for part in re.split(r"[^a-z]+", plain):
        seen |= set(_SHORT.get(part, ()))
    for corner in _CORNERS:
        if seen == set(corner):
            return corner
    return None


def _text(value: object) -> str:
    """A text, or a list of texts, as TOML writes it."""
    return json.dumps(value, ensure_ascii=False)
