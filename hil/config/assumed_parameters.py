"""Assumed parameters: keys of the bench file that scale a result or a safety figure, each beside its table.

A table lists its parameters in `PARAMETERS`. Cross-checks (`hil.bench.cross_checks`) compare them with what
the bench measures anyway; a parameter without one on a bench is unconfirmed, and says what would measure it.
`wrong` are mistakes that people make: the campaign of wrong values (`hil faults --configuration`) writes them
into the file.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Mistake = Callable[[Any], Any]


@dataclass(frozen=True)
class Parameter:
    """A key that the bench takes for granted until a measurement confirms it.

    Attributes:
        key: key in its table.
        wrong: mistakes: each makes a wrong value of a true one.
        by: kinds of devices of which one shows it, at rest or in the first motion.
        unlike: mistakes that are no value of the key: options of the emulated device, with a value that
            differs from what the key takes for granted.
    """

    key: str
    wrong: tuple[Mistake, ...] = ()
    by: tuple[str, ...] = ()
    unlike: tuple[tuple[str, Any], ...] = ()


def times(factor: float) -> Mistake:
    """The value, or every value of a list, times a factor."""

    def wrong(true: Any) -> Any:
        if isinstance(true, (list, tuple)):
            return tuple(wrong(part) for part in true)
        return type(true)(round(true * factor)) if isinstance(true, int) else true * factor

    return wrong


def plus(*by: float) -> Mistake:
    """A list with something added to each of its values; beyond the given ones nothing is."""

    def wrong(true: Any) -> Any:
        return tuple(value + (by[k] if k < len(by) else 0.0) for k, value in enumerate(true))

    return wrong


def each(*by: float) -> Mistake:
    """A list with each value times its own factor, as 1 or -1 for signs."""

    def wrong(true: Any) -> Any:
        return tuple(factor * value for factor, value in zip(by, true, strict=True))

    return wrong


def order(*by: int) -> Mistake:
    """A list in another order: the places from which its values come."""
    return lambda true: tuple(true[k] for k in by)


def instead(value: Any) -> Mistake:
    """A fixed value."""
    return lambda true: value


def turned(axis: str, by_deg: float) -> Mistake:
    """A quaternion (w, x, y, z), turned about an axis of the body."""
    half = 0.5 * math.radians(by_deg)
    w, v = math.cos(half), math.sin(half)
    turn = (w, *(v * (axis == name) for name in "xyz"))

    def wrong(true: Any) -> Any:
        a, b, c, d = turn
        e, f, g, h = true
        return (
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        )

    return wrong


TURNED = tuple(turned(axis, by_deg) for axis in "zxy" for by_deg in (90.0, 10.0, 180.0))
"""Mistakes in a mount: a device that is turned about each axis of the body."""


def parameters_of(tables: Mapping[str, Any]) -> Iterator[tuple[str, Any, Parameter]]:
    """Dotted key, value and declaration of every parameter of a bench file that has a value.

    Args:
        tables: tables by name: `robot`, `environment`, `alignment` and those of the devices.
    """
    for name, table in tables.items():
        declared: Sequence[Parameter] = getattr(table, "PARAMETERS", ())
        for one in declared:
            value = getattr(table, one.key)
            if value is not None:
                yield f"{name}.{one.key}", value, one
