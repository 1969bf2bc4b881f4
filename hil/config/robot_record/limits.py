"""Limits of the values in parts of a record: plain, finite, and within what their procedures pass."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

ZERO_LIMIT_RAD = math.radians(6.0)
"""A steering axis that is further off has its horn on another tooth."""
SCALE_LIMITS = (0.7, 1.35)
"""Limits of a camera's scale: reported over true distance; users of the T265 report deviations up to 20 %."""
_LIMITS: Mapping[str, tuple[float, float, str, str]] = {
    "alignment.steer_zero_rad": (-ZERO_LIMIT_RAD, ZERO_LIMIT_RAD, "rad", "steering_zero"),
    "tracker.scale": (*SCALE_LIMITS, "times the true distance", "tracker_extrinsics"),
}
"""Limits of procedures that are narrower than those of the bench file, by key: low, high, unit, procedure."""


def not_plain(value: object) -> Iterator[str]:
    """Elements of a value that are no number, text, list or table, or are not finite, in words."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        for one in value:
            yield from not_plain(one)
    elif isinstance(value, float) and not math.isfinite(value):
        yield f"{value} is no finite number"
    elif not isinstance(value, (str, bool, int, float)):
        yield f"a {type(value).__name__} is no number, text, list or table"


def implausible(values: Mapping[str, Any]) -> Iterator[str]:
    """Plain values, by key, that no procedure would have passed: `key: what is wrong`."""
    for key, (low, high, unit, procedure) in _LIMITS.items():
        value: Any = values.get(key)
        numbers = [v for v in (value if isinstance(value, (list, tuple)) else [value]) if _is_number(v)]
        if beyond := ", ".join(f"{v:g}" for v in numbers if not low <= v <= high):
            yield f"{key}: {beyond}: {procedure} lets {low:.3g} to {high:.3g} {unit} pass"


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
