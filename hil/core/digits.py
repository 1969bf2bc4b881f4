"""Digits needed to print a value differently from each of its limits."""

from __future__ import annotations

from collections.abc import Iterable

_EXACT = 17


def digits_apart(value: float, others: Iterable[float | None], least: int = 4) -> int:
    """Significant digits with which a value reads otherwise than all that it differs from.

    Args:
        value: to be printed.
        others: such as its limits; None for those that there are not.
        least: how many it has anyway.
    """
    different = [other for other in others if other is not None and other != value]
    return next(
        (
            n
            for n in range(least, _EXACT)
            if all(float(f"{value:.{n}g}") != float(f"{other:.{n}g}") for other in different)
        ),
        _EXACT,
    )
