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
        difference: difference of the measurements, relative or in rad; NaN where it gives none.
        text: the contradiction in words, with keys; empty for none.
    """

    key: str
    value: Any
    state: State
    by: str = ""
    says: Any = math.nan
    difference: float = math.nan
    text: str = ""

    def to_json(self) -> dict[str, Any]:
        """The entry of `parameters`."""
        shown = {name: _finite(getattr(self, name)) for name in ("value", "says", "difference")}
        return {"key": self.key, "state": self.state, "by": self.by, **shown}


def _finite(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def strongest(found: Iterable[CrossCheck]) -> dict[str, CrossCheck]:
    """The result that counts of each key: a contradiction, else a confirmation; of like ones the latest."""
    best: dict[str, CrossCheck] = {}
    for check in found:
        known = best.get(check.key)
        if known is None or _RANK.index(check.state) <= _RANK.index(known.state):
            best[check.key] = check
    return best
