"""Keys of older bench files (0.1): told where they belong now, and lifted in what was recorded with them.

Keys that are gone are refused in a bench file, so that nobody believes in them, and left out of what was
recorded.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from hil.config.environment import FLOOR_TILT_RAD

_MOVED = {
    "surface": "wall or floor follows from environment.tilt_rad (0 floor, 1.5708 wall)",
    "emulation.surface": "it is environment.surface now",
    "emulation.tilt_rad": "it is environment.tilt_rad now",
    "emulation.start_pose": "it is environment.start_pose now",
}

_GONE = {
    "estimator.gates.two_dof": "no gate ever used it: remove it",
    "encoders.backlash_limit_rad": "nothing ever watched it: remove it; `steering_zero` judges backlash",
}


def told_where_now(tree: Mapping[str, Any]) -> Iterator[str]:
    """Of every old key in a parsed bench file, where its value goes now, or that it is gone."""
    yield from _told_of_moved(tree)
    for dotted, value in _gone(tree):
        yield f"{dotted}: {_GONE[dotted]} (found {value!r})"


def _told_of_moved(tree: Mapping[str, Any]) -> Iterator[str]:
    for dotted, where in _MOVED.items():
        table, _, key = dotted.rpartition(".")
        values = tree.get(table) if table else tree
        if isinstance(values, Mapping) and key in values:
            yield f"{dotted}: {where} (found {values[key]!r})"


_AREA = ("x_range_m", "y_range_m")


def area_twice(tree: Mapping[str, Any]) -> Iterator[str]:
    """Of every limit of the usable area that is given at its place and at its older one, `[safety]`."""
    safety, environment = tree.get("safety"), tree.get("environment")
    if isinstance(safety, Mapping) and isinstance(environment, Mapping):
        for key in _AREA:
            if key in safety and key in environment:
                yield f"safety.{key}: environment.{key} is given, too; it belongs there: remove this one"


def _area_lifted(tree: Mapping[str, Any]) -> dict[str, Any]:
    """With the usable area in `[environment]`, where it was in `[safety]`; what is there already stays."""
    safety, environment = tree.get("safety"), tree.get("environment", {})
    if not isinstance(safety, Mapping) or not isinstance(environment, Mapping):
        return dict(tree)
    area = {key: safety[key] for key in _AREA if key in safety}
    if not area:
        return dict(tree)
    rest = {key: value for key, value in safety.items() if key not in area}
    return {**tree, "safety": rest, "environment": {**area, **environment}}


def _gone(tree: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Dotted keys that nothing reads any more, each with its value; keys of other models are theirs."""
    for dotted in _GONE:
        *tables, key = dotted.split(".")
        table: Any = tree
        for name in tables:
            table = table.get(name) if isinstance(table, Mapping) else None
        if isinstance(table, Mapping) and key in table and table.get("model", "as5045") == "as5045":
            yield dotted, table[key]


def _without(tree: Mapping[str, Any], dotted: str) -> dict[str, Any]:
    key, _, below = dotted.partition(".")
    if below:
        return {**tree, key: _without(tree[key], below)}
    return {name: value for name, value in tree.items() if name != key}


def lifted(tree: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration with its old keys where they belong now; what is there already stays.

    Keys that are gone are left out. Where the old keys contradict each other, what the robot was guarded by
    counts: the top-level `surface`.
    """
    for dotted, _ in list(_gone(tree)):
        tree = _without(tree, dotted)
    tree = _area_lifted(tree)
    emulation, environment = tree.get("emulation", {}), tree.get("environment", {})
    if not any(True for _ in _told_of_moved(tree)) or not isinstance(environment, Mapping):
        return dict(tree)
    rest = {key: value for key, value in tree.items() if key != "surface"}
    old: dict[str, Any] = {}
    if isinstance(emulation, Mapping):
        names = ("surface", "tilt_rad", "start_pose")
        old = {key: emulation[key] for key in names if key in emulation}
        rest["emulation"] = {key: value for key, value in emulation.items() if key not in names}
    on_wall, tilt_rad = tree.get("surface", "wall") != "floor", old.get("tilt_rad")
    if not isinstance(tilt_rad, (int, float)) or (tilt_rad > FLOOR_TILT_RAD) is not on_wall:
        old["tilt_rad"] = math.pi / 2.0 if on_wall else 0.0
    return {**rest, "environment": {**old, **environment}}
