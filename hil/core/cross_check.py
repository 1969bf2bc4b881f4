"""Results of cross-checks: what a measurement says about a parameter of the bench file.

A parameter is confirmed or contradicted by a measurement that would look different if it were wrong, or
unconfirmed: nothing measures it now. A confirmation says within what bound: the difference up to which the
measurement confirms.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, Literal, NamedTuple

Unit = Literal["1", "rad", "m", "N"]
State = Literal["confirmed", "contradicted", "unconfirmed"]
_RANK: Sequence[State] = ("contradicted", "confirmed", "unconfirmed")


class CrossCheck(NamedTuple):
    """The result of a cross-check of one parameter.

    Attributes:
        key: key of the parameter in the bench file.
        value: its value there.
        state: `confirmed`, `contradicted`, or `unconfirmed` where nothing measures it now.
        by: the measurement that was compared, or what would be one.
        says: value for which this measurement speaks; NaN or None where it gives none.
        difference: difference of the measurements, in `unit`; NaN where it gives none.
        within: difference up to which the measurement confirms, in `unit`; NaN for a choice, such as a sign.
        unit: unit of both, `1` for a share of the value.
        text: the contradiction in words, with keys; empty for none.
        beside: what the measurement does not show of the parameter; empty for nothing.
        on: date of a confirmation that the robot's record keeps, ISO 8601; empty for one of now.
        given: keys that the same measurement takes as right: if these are confirmed by nothing else, a like
            error of both would not show.
    """

    key: str
    value: Any
    state: State
    by: str = ""
    says: Any = math.nan
    difference: float = math.nan
    text: str = ""
    beside: str = ""
    on: str = ""
    within: float = math.nan
    unit: Unit = "1"
    given: tuple[str, ...] = ()

    @property
    def bound(self) -> str:
        """The bound in words, such as `within 0.02 rad`; empty for none."""
        return bound_text(self.within, self.unit)

    def to_json(self) -> dict[str, Any]:
        """The entry of `parameters`."""
        shown = {name: _finite(getattr(self, name)) for name in ("value", "says", "difference", "within")}
        unit = None if shown["difference"] is None and shown["within"] is None else self.unit
        return {
            "key": self.key,
            "state": self.state,
            "by": self.by,
            "on": self.on or None,
            **shown,
            "unit": unit,
        }


def bound_text(within: float | None, unit: str) -> str:
    """A bound in words, such as `within 30 %`; empty for none.

    Args:
        within: the bound; None or NaN for none.
        unit: its unit, `1` for a share.
    """
    if within is None or not math.isfinite(within):
        return ""
    return f"within {100.0 * within:.2g} %" if unit == "1" else f"within {within:.2g} {unit}"


def _finite(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def strongest(found: Iterable[CrossCheck]) -> dict[str, CrossCheck]:
    """The result that counts of each key: a contradiction, else a confirmation; of like ones the latest.

    Of confirmations one of the whole parameter counts, before one that leaves something beside or takes other
    keys as right.
    """
    best: dict[str, CrossCheck] = {}
    for check in found:
        known = best.get(check.key)
        if known is None or _rank(check) <= _rank(known):
            best[check.key] = check
    return best


def _rank(check: CrossCheck) -> tuple[int, bool, bool]:
    return _RANK.index(check.state), bool(check.beside), bool(check.given)
