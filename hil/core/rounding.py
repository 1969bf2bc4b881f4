"""Digits needed to print a value differently from each of its limits."""

from collections.abc import Iterable

_EXACT = 17


def digits_apart(value: float, others: Iterable[float | None], least: int = 4) -> int:
    """Significant digits that print a value differently from every other value.

    Args:
        value: value to be printed.
        others: values to tell it from, such as its limits; None and equal values are ignored.
        least: smallest number of digits.
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
