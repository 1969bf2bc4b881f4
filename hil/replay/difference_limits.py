"""Limits of the difference between a replay and its recording where their arithmetic differs.

Rounding differs in the last digits between processors and libraries (`hil.support.arithmetic_fingerprint`).
Over whole recordings these differences stay small: `LIMITS` lies about a thousand times above the largest one
that was found, and well below the resolution of any sensor. Everything that is not a number must be equal:
events, which samples were used, flags, counts.
"""

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.core.geometry import Array
from hil.core.signals import Event
from hil.recording.record_comparison import first_difference


@dataclass(frozen=True)
class Limit:
    """Limit of the difference of one quantity.

    Attributes:
        value: largest difference that agrees.
        unit: unit of `value`: `m`, `rad`, `rad/s`, ... or the quantity that `value` is a share of.
        least: least size of a value, for a limit that is a share of it: smaller sizes count as this one.
    """

    value: float
    unit: str
    least: float = 0.0


OF_SIGMA, OF_SIZE = "of sigma_i sigma_j", "of its size"
LIMITS: Mapping[str, Limit] = {
    "position_m": Limit(1e-6, "m"),
    "heading_rad": Limit(1e-6, "rad"),
    "velocity_m_s": Limit(1e-6, "m/s"),
    "yaw_rate_rad_s": Limit(1e-6, "rad/s"),
    "gyro_bias_rad_s": Limit(1e-6, "rad/s"),
    "covariance": Limit(1e-5, OF_SIGMA),
    "diagnostics": Limit(1e-4, OF_SIZE, least=0.01),
    "measurements": Limit(1e-9, OF_SIZE, least=1.0),
    "reference": Limit(1e-9, OF_SIZE, least=1.0),
    "wheel_rate_rad_s": Limit(1e-4, "rad/s"),
    "steering_rad": Limit(1e-3, "rad"),
}
"""Limits by quantity. Steering's is widest: near standstill its vector has almost no length."""

_OF_FIELD: Mapping[str, tuple[str, ...]] = {
    "measurements": ("measurements",),
    "reference": ("reference",),
    "pose_body_in_wall": ("position_m", "position_m", "heading_rad"),
    "twist_body": ("velocity_m_s", "velocity_m_s", "yaw_rate_rad_s"),
    "covariance": ("covariance",),
    "diagnostics": ("diagnostics",),
    "gyro_bias_rad_s": ("gyro_bias_rad_s",),
    "wheel_rate_rad_s": ("wheel_rate_rad_s",),
    "drive_velocity_rad_s": ("wheel_rate_rad_s",),
    "steering_rad": ("steering_rad",),
    "steer_position_rad": ("steering_rad",),
}
"""Quantity of a field by its name, or of each of its elements; it holds for all that the field contains."""
_WHOLE = (("measurements",), ("reference",))
"""Quantities that hold for everything in their field, whatever its name."""
_DECIMALS = re.compile(r"\d+\.\d+")

Fields = Iterable[tuple[str, Any, Any]]


class Agreement:
    """Largest differences between recorded and decided cycles, by quantity.

    Attributes:
        largest: largest difference by name in `LIMITS`, in the unit given there; only quantities of which
            there was a number.
        flip: the first difference of the latest cycle in something other than a number: a flag, a count, an
            event. None without one.
    """

    def __init__(self) -> None:
        self.largest: dict[str, float] = {}
        self.flip: str | None = None

    def take(self, recorded: Mapping[str, Any], decided: Mapping[str, Any]) -> str | None:
        """Take one cycle.

        Args:
            recorded: fields of a cycle record by name.
            decided: the same fields as they were decided again.

        Returns:
            The first field beyond its limit with both values, or None.
        """
        self.flip = None
        return self._first(((name, recorded[name], decided[name]) for name in recorded), "", ())

    def _first(self, fields: Fields, where: str, quantities: tuple[str, ...]) -> str | None:
        """Compare all fields, so that `largest` is complete; returns the first one beyond its limit."""
        first: str | None = None
        for name, a, b in fields:
            place = f"{where}.{name}" if where else name
            inner = quantities if quantities in _WHOLE else _OF_FIELD.get(name, quantities)
            found = self._compare(a, b, place, inner)
            first = found if first is None else first
        return first

    def _compare(self, a: Any, b: Any, where: str, quantities: tuple[str, ...]) -> str | None:
        fields = _fields(a, b)
        if fields is not None:
            return self._first(fields, where, quantities)
        if quantities and isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.shape == b.shape:
            return self._compare_arrays(a, b, where, quantities)
        if quantities and isinstance(a, float) and isinstance(b, float):
            return self._judge(quantities[0], difference(a, b, LIMITS[quantities[0]]), a, b, where)
        found = first_difference(a, b, where)
        self.flip = self.flip or found
        return found

    def _compare_arrays(self, a: Array, b: Array, where: str, quantities: tuple[str, ...]) -> str | None:
        recorded, decided = a.ravel().tolist(), b.ravel().tolist()
        sigmas = np.sqrt(np.diagonal(a).clip(min=0.0)).tolist() if quantities == ("covariance",) else []
        first: str | None = None
        for k, (x, y) in enumerate(zip(recorded, decided, strict=True)):
            quantity = quantities[k % len(quantities)]
            off = difference(x, y, LIMITS[quantity])
            if sigmas and off:
                scale = sigmas[k // len(sigmas)] * sigmas[k % len(sigmas)]
                off = off / scale if scale > 0.0 else math.inf
            index = [int(i) for i in np.unravel_index(k, a.shape)] if off else []
            found = self._judge(quantity, off, x, y, f"{where}{index}")
            first = found if first is None else first
        return first

    def _judge(self, quantity: str, off: float, a: float, b: float, where: str) -> str | None:
        """Keep a difference if it is the largest; returns its description if it is beyond the limit."""
        limit, size = LIMITS[quantity], off if math.isfinite(off) else 0.0
        self.largest[quantity] = max(self.largest.get(quantity, 0.0), size)
        if off <= limit.value:
            return None
        found = f"{where}: was {a!r}, now {b!r}"
        if math.isfinite(off):
            return f"{found}, more than {limit.value:g} {limit.unit} apart"
        if math.isfinite(a) and math.isfinite(b):
            self.flip = self.flip or found
        return found


def difference(a: float, b: float, limit: Limit) -> float:
    """How far two numbers are apart, as their limit counts it.

    Args:
        a: recorded number.
        b: number computed again.
        limit: limit of their quantity.

    Returns:
        0 for equal numbers and for two NaN; infinite where one of them is not finite, and for whole numbers
        that differ where the limit is a share of the size: these are counts.
    """
    if a == b or (a != a and b != b):
        return 0.0
    off = abs(a - b)
    if not math.isfinite(off):
        return math.inf
    if limit.unit == OF_SIZE:
        counts = float(a).is_integer() and float(b).is_integer()
        return math.inf if counts else off / max(abs(a), abs(b), limit.least)
    return off


def same_text(a: str, b: str) -> bool:
    """Whether two messages are equal but for the last digit of decimal numbers in them."""
    if a == b:
        return True
    if _DECIMALS.sub("", a) != _DECIMALS.sub("", b):
        return False
    pairs = zip(_DECIMALS.findall(a), _DECIMALS.findall(b), strict=True)
    return all(
        x.index(".") - len(x) == y.index(".") - len(y) and abs(_digits(x) - _digits(y)) <= 1 for x, y in pairs
    )


def _digits(number: str) -> int:
    return int(number.replace(".", ""))


def _fields(a: Any, b: Any) -> Fields | None:
    """Named parts of two values of the same structure; None for a leaf or for different structures."""
    if isinstance(a, Event) and isinstance(b, Event) and same_text(a.message, b.message):
        b = dataclasses.replace(b, message=a.message)
    if dataclasses.is_dataclass(a) and type(a) is type(b):
        return [(f.name, getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a)]
    if isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
        return [(str(k), x, y) for k, (x, y) in enumerate(zip(a, b, strict=True))]
    if isinstance(a, Mapping) and isinstance(b, Mapping) and set(a) == set(b):
        return [(str(key), a[key], b[key]) for key in a]
    return None
