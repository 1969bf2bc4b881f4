"""Keys of older bench files (0.1): told where they belong now, and lifted in what was recorded with them."""

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


def told_where_now(tree: Mapping[str, Any]) -> Iterator[str]:
    """Of every old key in a parsed bench file, where its value goes now."""
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


def lifted(tree: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration with its old keys where they belong now; what is there already stays.

    Where the old keys contradict each other, what the robot was guarded by counts: the top-level `surface`.
    """
    tree = _area_lifted(tree)
    emulation, environment = tree.get("emulation", {}), tree.get("environment", {})
    if not any(True for _ in told_where_now(tree)) or not isinstance(environment, Mapping):
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
