"""The control table of the XH430 servo as data: names, addresses, limits and units, read from `xh430.toml`.

Shared by the driver and by the emulated servo, which otherwise know nothing of each other.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True)
class Register:
    """One entry of the control table.

    Attributes:
        address, size: where it is, bytes.
        writable: access RW.
        eeprom: in the area that is kept without power and locked while torque is on.
        signed: two's complement.
        default: raw count after a factory reset.
        low, high: permitted raw counts, None where the register cannot be written or another bounds it.
        values: the only permitted raw counts, empty when a range holds.
        limit: name of the register that bounds the absolute value, or empty.
        unit, scale: SI unit, and SI value of one count (1 and no unit for flags).
    """

    name: str
    address: int
    size: int
    writable: bool
    eeprom: bool
    signed: bool = False
    default: int = 0
    low: int | None = None
    high: int | None = None
    values: tuple[int, ...] = ()
    limit: str = ""
    unit: str = ""
    scale: float = 1.0

    def encode(self, raw: int) -> bytes:
        """Little-endian bytes of a raw count."""
        return (raw & ((1 << 8 * self.size) - 1)).to_bytes(self.size, "little")

    def decode(self, data: bytes) -> int:
        """Raw count of little-endian bytes."""
        return int.from_bytes(data[: self.size], "little", signed=self.signed)

    def range_text(self) -> str:
        """The permitted raw counts in words."""
        if self.values:
            return "one of " + ", ".join(str(v) for v in self.values)
        return f"{self.low}..{self.high}" if self.low is not None else f"within +-{self.limit}"

    def permits(self, raw: int) -> bool:
        """Whether the table itself allows a raw count (a limit register may allow less)."""
        if self.values:
            return raw in self.values
        return self.low is None or self.high is None or self.low <= raw <= self.high


def _register(entry: Mapping[str, Any]) -> Register:
    fields = {k: v for k, v in entry.items() if k not in ("access", "area", "values")}
    return Register(
        writable=entry["access"] == "rw",
        eeprom=entry["area"] == "eeprom",
        values=tuple(entry.get("values", ())),
        **fields,
    )


def _indirect(block: Mapping[str, int], low: int, high: int) -> list[Register]:
    found = []
    for k in range(block["count"]):
        number, data = block["first"] + k, block["data"] + k
        found.append(
            Register(
                f"indirect_address_{number}", block["address"] + 2 * k, 2, True, False,
                default=data, low=low, high=high,
            )
        )  # fmt: skip
        found.append(Register(f"indirect_data_{number}", data, 1, True, False, low=0, high=255))
    return found


def _load() -> tuple[dict[str, Any], dict[str, Register]]:
    raw = tomllib.loads(Path(__file__).with_name("xh430.toml").read_text(encoding="utf-8"))
    registers = [_register(entry) for entry in raw["registers"]]
    for block in raw["indirect"]:
        registers += _indirect(block, raw["indirect_low"], raw["indirect_high"])
    return raw, {r.name: r for r in registers}


_RAW, _TABLE = _load()

TABLE: Mapping[str, Register] = MappingProxyType(_TABLE)
MODEL_NUMBER: int = _RAW["model_number"]
MODELS: Mapping[int, str] = MappingProxyType({int(k): v for k, v in _RAW["models"].items()})
TABLE_SIZE: int = _RAW["size"]
BAUD_RATES: Mapping[int, int] = MappingProxyType({int(k): v for k, v in _RAW["baud_rates"].items()})
BAUD_CODES: Mapping[int, int] = MappingProxyType({v: k for k, v in BAUD_RATES.items()})
HARDWARE_ERRORS: Mapping[int, str] = MappingProxyType({int(k): v for k, v in _RAW["hardware_errors"].items()})

COUNTS_PER_TURN = 4096
ZERO_COUNTS = 2048
RAD_PER_COUNT = TABLE["present_position"].scale
RAD_S_PER_COUNT = TABLE["present_velocity"].scale
A_PER_COUNT = TABLE["present_current"].scale
WATCHDOG_STEP_S = TABLE["bus_watchdog"].scale
FAST_READ_FIRMWARE = 45

CURRENT, VELOCITY, POSITION, EXTENDED, CURRENT_POSITION, PWM = 0, 1, 3, 4, 5, 16
MODE_NAMES: Mapping[int, str] = MappingProxyType(
    {
        CURRENT: "current",
        VELOCITY: "velocity",
        POSITION: "position",
        EXTENDED: "extended position",
        CURRENT_POSITION: "current-based position",
        PWM: "PWM",
    }
)


def model_text(number: int) -> str:
    """Name and number of a model."""
    name = {**{int(k): v for k, v in _RAW["other_models"].items()}, **MODELS}.get(number)
    return f"{number} ({name})" if name else str(number)


def models_text() -> str:
    """The models that the table holds for, in words."""
    return " or ".join(model_text(number) for number in MODELS)


def hardware_error_text(bits: int) -> str:
    """Names of the set bits of Hardware Error Status."""
    names = [name for bit, name in HARDWARE_ERRORS.items() if bits >> bit & 1]
    return ", ".join(names) if names else f"0x{bits:02X}"
