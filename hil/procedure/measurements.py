"""Declares what a procedure measures and within which limits, and judges the values.

Limits are declared before anything is measured. A declared measurement that is never set fails.
"""

import enum
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

from hil.core.errors import UsageError


class Verdict(str, enum.Enum):
    """Outcome of one measurement, or of a whole run."""

    PASS = "PASS"
    MARGINAL = "MARGINAL"
    FAIL = "FAIL"
    ABORTED = "ABORTED"
    ERROR = "ERROR"


@dataclass(frozen=True)
class Measurement:
    """One declared measurement.

    Attributes:
        name: short word or path, unique in the procedure.
        unit: SI or the usual unit; `1` for ratios, counts and yes/no.
        low, high: limits, both inclusive; None for no limit.
        marginal: width of the band inside a limit in which a value passes as MARGINAL, in `unit`.
        rationale: reason for the limits.

    Raises:
        UsageError: a limit is not a number or has no unit, no value can meet the limits, or the band is wider
            than the limits allow.
    """

    name: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    marginal: float = 0.0
    rationale: str = ""

    def __post_init__(self) -> None:
        where = f"measurement {self.name!r}"
        limits = [v for v in (self.low, self.high) if v is not None]
        if not self.name:
            raise UsageError("a measurement without name")
        for key, value in (("low", self.low), ("high", self.high), ("marginal", self.marginal)):
            if not isinstance(value, Real) and (value is not None or key == "marginal"):
                raise UsageError(f"{where}: {key} is {value!r}", expected="a number, as 1.5")
        if limits and not self.unit:
            raise UsageError(f"{where} has a limit without unit", expected="a unit, `1` for a plain number")
        if not all(math.isfinite(v) for v in limits):
            raise UsageError(f"{where} has limits {limits}", expected="finite numbers, or none")
        width = math.inf
        if self.low is not None and self.high is not None:
            width = self.high - self.low
            if width < 0:
                raise UsageError(f"{where}: low {self.low} is above high {self.high}")
        if not 0.0 <= self.marginal <= width / 2 or (self.marginal and not limits):
            raise UsageError(
                f"{where} has a marginal band of {self.marginal}",
                expected="at least 0, at most half of the distance between the limits",
            )

    @property
    def limited(self) -> bool:
        """Whether the measurement has limits; one without limits is only reported."""
        return self.low is not None or self.high is not None

    def declared(self) -> dict[str, Any]:
        """Return name, unit and limits as a JSON object."""
        limits = {"low": self.low, "high": self.high, "marginal": self.marginal}
        numbers = {key: None if value is None else float(value) for key, value in limits.items()}
        return {"name": self.name, "unit": self.unit, **numbers}

    def margin(self, value: float) -> float:
        """Return the distance to the nearest limit, positive inside; infinite without limits, NaN for NaN."""
        sides = [math.inf]
        if self.low is not None:
            sides.append(value - self.low)
        if self.high is not None:
            sides.append(self.high - value)
        return math.nan if math.isnan(value) else min(sides)

    def judge(self, value: float | None) -> Verdict:
        """Return the verdict on a value; None means never set."""
        if value is None or not math.isfinite(value):
            return Verdict.FAIL
        margin = self.margin(value)
        if margin < 0:
            return Verdict.FAIL
        return Verdict.MARGINAL if self.limited and margin < self.marginal else Verdict.PASS


def worst(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the worst of the verdicts; PASS if there are none."""
    order = list(Verdict)
    return max(verdicts, key=order.index, default=Verdict.PASS)


_SEVERAL = "a list of Measurement(NAME, UNIT, ...)"


def check_unique(measurements: Iterable[Measurement], owner: str) -> tuple[Measurement, ...]:
    """Return the measurements as a tuple, after a check of types and names.

    Args:
        measurements: declared measurements.
        owner: procedure that declares them, for error messages.

    Raises:
        UsageError: a name is declared twice, or an item is not a `Measurement`.
    """
    given: object = measurements
    if not isinstance(given, Iterable) or isinstance(given, (str, Mapping)):
        raise UsageError(f"{owner}: measurements is a {type(given).__name__}", expected=_SEVERAL)
    found: tuple[Any, ...] = tuple(given)
    for one in found:
        if not isinstance(one, Measurement):
            raise UsageError(f"{owner}: among the measurements is a {type(one).__name__}", expected=_SEVERAL)
    names = [m.name for m in found]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"{owner}: measurement {name!r} is declared twice")
    return found
