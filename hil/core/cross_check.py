"""Results of cross-checks: what a measurement says about a parameter of the bench file.

A parameter is confirmed or contradicted by a measurement that would look different if it were wrong, or
unconfirmed: nothing measures it now.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, Literal, NamedTuple

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
        difference: difference of the measurements, relative, in rad or m; NaN where it gives none.
        text: the contradiction in words, with keys; empty for none.
        beside: what the measurement does not show of the parameter; empty for nothing.
        on: date of a confirmation that the robot's record keeps, ISO 8601; empty for one of now.
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

    def to_json(self) -> dict[str, Any]:
        """The entry of `parameters`."""
        shown = {name: _finite(getattr(self, name)) for name in ("value", "says", "difference")}
        return {"key": self.key, "state": self.state, "by": self.by, "on": self.on or None, **shown}


def _finite(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def strongest(found: Iterable[CrossCheck]) -> dict[str, CrossCheck]:
    """The result that counts of each key: a contradiction, else a confirmation; of like ones the latest.

    Of confirmations one of the whole parameter counts, before one that leaves something beside.
    """
    best: dict[str, CrossCheck] = {}
    for check in found:
        known = best.get(check.key)
        if known is None or _rank(check) <= _rank(known):
            best[check.key] = check
    return best


def _rank(check: CrossCheck) -> tuple[int, bool]:
    return _RANK.index(check.state), bool(check.beside)
