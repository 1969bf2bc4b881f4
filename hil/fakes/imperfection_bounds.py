"""Bounds of the values in `[emulation.KIND]`: imperfections of an emulated device.

The bounds of a value follow from its unit, which is the end of its name (`latency_s`,
`scale_sigma`). A pose that arrives a year late, or noise below zero, is a typing error. A device that needs
other bounds writes `Annotated[float, Within(...)]` in its dataclass; these replace the bounds of the unit.
Fields of another package only need to be finite and within the bounds that it gives.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from typing import Any, get_args, get_type_hints

from hil.config.field_types import bounds_of

BOUNDS: Mapping[str, tuple[float, float]] = {
    "leakage_s": (0.01, 3600.0),
    "supply_v": (1.0, 60.0),
    "_m_sqrt_m": (0.0, 1.0),
    "_rad_sqrt_s": (0.0, 1.0),
    "_m_s2": (0.0, 100.0),
    "_rad_s": (0.0, 100.0),
    "_m_s": (0.0, 100.0),
    "_per_s": (0.0, 1000.0),
    "_probability": (0.0, 1.0),
    "_share": (0.0, 1.0),
    "_sigma": (0.0, 0.5),
    "_ppm": (0.0, 10_000.0),
    "_hz": (1.0, 10_000.0),
    "_rad": (0.0, math.pi),
    "_per_v": (1.0, 20_000.0),
    "_ut": (0.0, 1000.0),
    "_ohm": (0.0, 10.0),
    "_v": (0.0, 60.0),
    "_a": (0.0, 100.0),
    "_c": (-50.0, 100.0),
    "_s": (0.0, 60.0),
    "_m": (0.0, 10.0),
}
"""End of a name -> smallest and largest value; the first match counts. Components of position vectors (`_m`)
may be negative."""

_hints: Callable[[Any], dict[str, Any]] = cache(partial(get_type_hints, include_extras=True))
_UNIT = "_wxyz"
_OURS = "hil."
_ROTATION_NORM = (0.99, 1.01)


def invalid_values(imperfections: type[Any], given: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield key and reason of every invalid value.

    Args:
        imperfections: dataclass of the device's true imperfections.
        given: values of its fields, as read from a file or an option.
    """
    hints = _hints(imperfections)
    for key, value in given.items():
        why = _truth_value(hints[key], value) or _not_finite(value)
        if not why and imperfections.__module__.startswith(_OURS):
            why = _beyond(key, hints[key], value)
        if why:
            yield key, why


def _truth_value(hint: Any, value: Any) -> str:
    """Return the reason if a number is given as true or false, which pydantic would convert to 1 and 0."""
    kinds = {hint, *get_args(hint)}
    for part in value if isinstance(value, (list, tuple)) else (value,):
        if isinstance(part, bool) and bool not in kinds:
            return f"expected a number, found {str(part).lower()}"
    return ""


def _numbers(value: Any) -> Iterator[float]:
    parts = value.values() if isinstance(value, Mapping) else value
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        yield value
    elif isinstance(parts, (list, tuple)) or isinstance(value, Mapping):
        for part in parts:
            yield from _numbers(part)


def _not_finite(value: Any) -> str:
    wrong = next((number for number in _numbers(value) if not -math.inf < number < math.inf), None)
    return "" if wrong is None else f"expected a finite number, found {wrong:g}"


def _beyond(key: str, hint: Any, value: Any) -> str:
    numbers = list(_numbers(value))
    if not numbers or any(own is not None for _, own in bounds_of(hint)):
        return ""
    if key.endswith(_UNIT):
        norm = math.hypot(*numbers)
        return "" if _ROTATION_NORM[0] < norm < _ROTATION_NORM[1] else f"has norm {norm:.3g}, not 1"
    unit = _of_the_unit(key, hint)
    if unit is None:
        return ""
    low, high = unit
    wrong = next((number for number in numbers if not low <= number <= high), None)
    return "" if wrong is None else f"expected {low:g} to {high:g}, found {wrong!r}"


def _of_the_unit(key: str, hint: Any) -> tuple[float, float] | None:
    """Smallest and largest value for the unit at the end of a key; None without a known unit."""
    suffix = next((s for s in BOUNDS if key.endswith(s)), None)
    if suffix is None:
        return None
    low, high = BOUNDS[suffix]
    return (-high if suffix == "_m" and len(list(bounds_of(hint))) > 1 else low), high


def ranges(imperfections: type[Any]) -> dict[str, tuple[str, ...]]:
    """Return the bounds of every numeric field as text; fields without bounds are left out.

    Args:
        imperfections: dataclass of the device's true imperfections.
    """
    found: dict[str, tuple[str, ...]] = {}
    for key, hint in _hints(imperfections).items():
        numbers = [own for _, own in bounds_of(hint)]
        unit = _of_the_unit(key, hint)
        of_unit = "" if unit is None else f"{unit[0]:g} .. {unit[1]:g}"
        if key.endswith(_UNIT):
            found[key] = ("norm 1",)
        elif numbers:
            found[key] = tuple(of_unit if own is None else own.range_text() for own in numbers)
    return found
