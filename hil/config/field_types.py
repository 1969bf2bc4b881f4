"""The strict base of all tables of the bench file, bounds of numbers, and types of values."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from numbers import Real
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    ValidationInfo,
    field_validator,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from hil.support.file_reading import printable

RECORDED: Mapping[str, bool] = {"recorded": True}
"""Validation context of a recorded configuration, so that old recordings stay readable."""

TOP_WHEEL_RATE_RAD_S = 7.0
"""No XH430-W210 turns faster: 62 rpm without load at 14.8 V (ROBOTIS e-manual), 67 at the 16 V it stands."""


class Strict(BaseModel):
    """Base of all tables: unknown keys rejected, values frozen, numbers finite and texts of one line.

    A number must not be true, false or in quotes. Every number has bounds (`Within`).
    """

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _plain(cls, value: Any, info: ValidationInfo) -> Any:
        if info.context != RECORDED and info.field_name is not None:
            _check_plain(value, frozenset(_types_in(cls.model_fields[info.field_name].annotation)))
        return value


def _check_plain(value: Any, meant: frozenset[Any]) -> None:
    """Refuse truth values where none is meant, numbers in quotes, and control characters in texts."""
    for part in _parts(value):
        if isinstance(part, str):
            if printable(part) != part or "\n" in part:
                raise PydanticCustomError("text", "must hold no control characters")
            if str not in meant and meant & {int, float} and Literal not in meant:
                raise PydanticCustomError("quoted", "must be a number, without quotes")
        elif isinstance(part, bool) and bool not in meant and meant & {int, float}:
            raise PydanticCustomError("truth", "must be a number")


def _parts(value: Any) -> Iterator[Any]:
    """Values inside lists; tables are left out, because their own models check them."""
    if isinstance(value, (list, tuple)):
        for part in value:
            yield from _parts(part)
    else:
        yield value


def _types_in(annotation: Any) -> Iterator[Any]:
    """Plain types that a value may have, or have in it; `Literal` for one of several given values."""
    inner = get_args(annotation)
    if get_origin(annotation) is Literal:
        yield Literal
    elif get_origin(annotation) is Annotated:
        yield from _types_in(inner[0])
    elif inner:
        for part in inner:
            yield from _types_in(part)
    else:
        yield annotation


@dataclass(frozen=True)
class Within:
    """Plausible bounds of a number in the bench file; a recorded configuration is not checked.

    Attributes:
        low, high: lowest and highest permitted number, both included; anything that is no finite number is
            beyond them.
        why: reason for the bounds.
        smallest: least absolute value, for a number of either sign that cannot be 0.
    """

    low: float
    high: float
    why: str
    smallest: float = 0.0

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        whole, also_text = source is int, source not in (int, float)
        numbers = core_schema.float_schema(allow_inf_nan=True) if source is float else handler(source)

        def check(value: Any, info: ValidationInfo) -> Any:
            if info.context == RECORDED or (also_text and isinstance(value, (bool, str))):
                return value
            if self.permits(value, whole=whole):
                return value
            raise PydanticCustomError(
                "beyond", "must {requirement}", {"requirement": self.requirement(whole=whole)}
            )

        return core_schema.with_info_before_validator_function(check, numbers)

    def permits(self, value: object, *, whole: bool = False) -> bool:
        """Whether a value lies within; true, false and texts do not, nor a fraction where `whole`."""
        if isinstance(value, bool) or not isinstance(value, Real):
            return False
        number: Any = value
        inside = bool(self.low <= number <= self.high and abs(number) >= self.smallest)
        return inside and (not whole or number == round(number))

    def requirement(self, *, whole: bool = False) -> str:
        """The bounds and their reason in words."""
        number = "be a whole number within " if whole else "lie within "
        return f"{'be ' if self._is_sign() else number}{self.range_text()}: {self.why}"

    def range_text(self) -> str:
        """The bounds in words."""
        if self._is_sign():
            return f"{self.low:g} or {self.high:g}"
        size = f", in size at least {self.smallest:.10g}" if self.smallest else ""
        return f"{self.low:.10g} .. {self.high:.10g}{size}"

    def _is_sign(self) -> bool:
        return self.smallest == self.high == -self.low


def bounds_of(annotation: Any, metadata: Iterable[Any] = ()) -> Iterator[tuple[type, Within | None]]:
    """Every number that a field may hold: its type, and its bounds where it has some.

    Args:
        annotation: type of the field, with its annotations.
        metadata: further annotations of the field.
    """
    if get_origin(annotation) is Annotated:
        plain, *more = get_args(annotation)
        yield from bounds_of(plain, (*metadata, *more))
    elif annotation in (int, float):
        yield annotation, next((m for m in metadata if isinstance(m, Within)), None)
    elif get_origin(annotation) is not Literal:
        of_one = metadata if get_origin(annotation) in (Union, UnionType) else ()
        for inner in get_args(annotation):
            yield from bounds_of(inner, of_one)


def _true_or_false(value: object, info: ValidationInfo) -> object:
    if isinstance(value, bool) or info.context == RECORDED:
        return value
    raise PydanticCustomError("switch", "must be true or false, without quotes")


Switch = Annotated[bool, BeforeValidator(_true_or_false)]
"""`true` or `false`; no word or number that may mean one of them."""


_ROUNDING = 1e-12

Cosine = Annotated[float, Within(-1.01, 1.01, "part of a unit quaternion (w, x, y, z)")]
Quaternion = tuple[Cosine, Cosine, Cosine, Cosine]


def _unit(value: Quaternion) -> Quaternion:
    """Scale a quaternion to norm 1; one that has norm 1 but for rounding stays as it is."""
    norm = math.sqrt(sum(v * v for v in value))
    if not 0.99 < norm < 1.01:
        raise ValueError(f"the quaternion (w, x, y, z) has norm {norm:.3g}, not 1")
    if abs(norm - 1.0) < _ROUNDING:
        return value
    w, x, y, z = value
    return (w / norm, x / norm, y / norm, z / norm)


UnitQuaternion = Annotated[Quaternion, AfterValidator(_unit)]
"""(w, x, y, z) within 1 % of unit norm; normalised."""

Patience = Annotated[float, Within(0.001, 60.0, "s; a minute of silence is an outage, whatever the device")]
"""Time (s) for which something may be silent, stuck or in the making, or at which it is looked at again."""

Freshness = Annotated[float, Within(0.001, 10.0, "s; the robot drives 1.2 m in 10 s")]
"""Age (s) of data, or time without a change, up to which they are believed."""

Delay = Annotated[float, Within(0.0, 0.5, "s; what comes later is of no use to a loop")]
"""Time (s) from a measurement to its arrival, or allowed on top of it; may be 0."""

Angle = Annotated[float, Within(-7.0, 7.0, "a turn is 6.28, angles are in radians")]

SteeringZero = Annotated[
    float, Within(-3.1416, 3.1416, "half a turn either way; give radians: 5 deg is 0.0873")
]
"""Angle (rad) that a steering servo reports while its wheel stands straight."""

HeadingLimit = Annotated[float, Within(0.001, 1.5708, "rad; beyond a quarter turn the thrust pulls down")]
WheelRate = Annotated[float, Within(0.01, TOP_WHEEL_RATE_RAD_S, "rad/s; no XH430-W210 turns faster")]

Sign = Annotated[int, Within(-1, 1, "-1 where something is mounted the other way round", smallest=1)]
Signs = tuple[Sign, Sign, Sign, Sign]
"""One sign per wheel, in the order FL, BL, BR, FR."""

Baud = Annotated[int, Within(1200, 12_000_000, "bits per second of a serial line")]
NetworkPort = Annotated[int, Within(1, 65_535, "a UDP port")]
PolePairs = Annotated[int, Within(1, 50, "pole pairs of a motor")]
FrameOffset = Annotated[int, Within(0, 0x3F, "the address switch of a node has six bits")]
MostKept = Annotated[int, Within(8, 100_000, "poses")]
PosesAgain = Annotated[int, Within(1, 10_000, "poses")]
