"""All columns of a recording that are in another unit, found one after the other and named at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.cleaning import Log

Found = TypeVar("Found")
_PLACES = {
    "phi": slice(0, 4),
    "delta": slice(4, 8),
    "w": slice(8, 12),
    "x, y": slice(0, 2),
    "theta": slice(2, 3),
}
_OF_TRUTH = ("x, y", "theta")


class UnitError(DataError):
    """Columns are in another unit.

    Attributes:
        units: factor to SI units for each of them: t, phi, delta, w, "x, y" or theta.
        problems: one line for each.
    """

    def __init__(
        self,
        path: str,
        message: str,
        units: Mapping[str, float],
        *,
        problems: tuple[str, ...] = (),
        expected: str = "",
        remedy: str = "",
    ) -> None:
        self.units = dict(units)
        super().__init__(path, "\n  ".join((message, *problems)), expected=expected, remedy=remedy)
        self.problems = problems or (str(self).removeprefix(f"{path}: "),)


def all_at_once(
    where: str, wheels: Log, truth: Log | None, build: Callable[[Log, Log | None], Found]
) -> Found:
    """Result of `build`, or one error that names all columns in another unit.

    A column that was found is converted for the next try, so that the others are compared with what is right.

    Args:
        where: the file, for messages.
        wheels: columns phi_1..4, delta_1..4 and, optionally, wheel rates 1..4.
        truth: columns x, y, theta; None without ground truth.
        build: reads both logs, and raises `UnitError` at the first wrong unit.

    Raises:
        UnitError: of one or of several columns.
        DataError: of `build`, where all units are right.
    """
    found = list[UnitError]()
    while True:
        try:
            built = build(wheels, truth)
        except UnitError as error:
            if error.units.keys() & _named(found).keys():
                break
            found.append(error)
            wheels = _converted(wheels, error.units, of_truth=False)
            truth = None if truth is None else _converted(truth, error.units, of_truth=True)
        except DataError:
            if not found:
                raise
            break
        else:
            if not found:
                return built
            break
    if len(found) == 1:
        raise found[0]
    problems = tuple(problem for error in found for problem in error.problems)
    raise UnitError(
        where, f"{len(found)} quantities are in another unit:", _named(found), problems=problems
    ) from None


def _named(found: list[UnitError]) -> dict[str, float]:
    return {column: to_si for error in found for column, to_si in error.units.items()}


def _converted(log: Log, units: Mapping[str, float], *, of_truth: bool) -> Log:
    """Log with the named columns in SI units; a time is that of wheels and ground truth alike."""
    factors: Array = np.ones(log.values.shape[1])
    for column, to_si in units.items():
        if column in _PLACES and (column in _OF_TRUTH) == of_truth:
            factors[_PLACES[column]] = to_si
    t_s = log.t_s * units.get("t", 1.0)
    receive_s = None if log.receive_s is None else log.receive_s * units.get("t", 1.0)
    return replace(log, t_s=t_s, values=log.values * factors, receive_s=receive_s)
