"""Types of values that several tables of the bench file share."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, GetCoreSchemaHandler, ValidationInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

Quaternion = tuple[float, float, float, float]

RECORDED: Mapping[str, bool] = {"recorded": True}
"""Validation context of a configuration that something was recorded with: history stays readable."""

TOP_WHEEL_RATE_RAD_S = 7.0
"""No XH430-W210 turns faster: 62 rpm without load at 14.8 V (ROBOTIS e-manual), 67 at the 16 V it stands."""


@dataclass(frozen=True)
class Within:
    """Bounds beyond which a number of the bench file cannot be meant; what was recorded passes.

    Attributes:
        low, high: permitted, both included; anything that is no finite number is beyond them.
        why: what the bounds come from.
        smallest: what its size has to be at least, for a number of either sign that cannot be 0.
    """

    low: float
    high: float
    why: str
    smallest: float = 0.0

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        numbers = core_schema.float_schema(allow_inf_nan=True)
        return core_schema.with_info_after_validator_function(self._check, numbers)

    def _check(self, value: float, info: ValidationInfo) -> float:
        if (self.low <= value <= self.high and abs(value) >= self.smallest) or info.context == RECORDED:
            return value
        raise PydanticCustomError("beyond", "must lie {told}", {"told": self.told()})

    def told(self) -> str:
        """The bounds and their reason in words."""
        size = f", in size at least {self.smallest:g}" if self.smallest else ""
        return f"within {self.low:g} .. {self.high:g}{size}: {self.why}"


def _true_or_false(value: object, info: ValidationInfo) -> object:
    if isinstance(value, bool) or info.context == RECORDED:
        return value
    raise PydanticCustomError("switch", "must be true or false, without quotes")


Switch = Annotated[bool, BeforeValidator(_true_or_false)]
"""`true` or `false`; no word or number that may mean one of them."""


_ROUNDING = 1e-12


def _unit(value: Quaternion) -> Quaternion:
    """Of norm 1, and the same again when it is read back: what has norm 1 but for rounding stays as it is."""
    norm = math.sqrt(sum(v * v for v in value))
    if not 0.99 < norm < 1.01:
        raise ValueError(f"the quaternion (w, x, y, z) has norm {norm:.3g}, not 1")
    if abs(norm - 1.0) < _ROUNDING:
        return value
    w, x, y, z = value
    return (w / norm, x / norm, y / norm, z / norm)


UnitQuaternion = Annotated[Quaternion, AfterValidator(_unit)]
"""(w, x, y, z) within 1 % of unit norm; normalised."""

Patience = Annotated[float, Within(0.001, 60.0, "a minute of silence is an outage, whatever the device")]
"""How long (s) something may be silent, stuck or in the making, or how often it is looked at."""

Freshness = Annotated[float, Within(0.001, 10.0, "the robot drives 1.2 m in 10 s")]
"""How old (s) or unchanging data may be and still be believed."""

HeadingLimit = Annotated[float, Within(0.001, 1.5708, "beyond a quarter turn the thrust pulls down")]
Angle = Annotated[float, Within(-7.0, 7.0, "rad; a turn is 6.28")]
WheelRate = Annotated[float, Within(0.01, TOP_WHEEL_RATE_RAD_S, "no XH430-W210 turns faster")]
