"""Codes that all servos of the X series have in common: modes, baud rates, hardware errors."""

from collections.abc import Mapping
from types import MappingProxyType

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

BAUD_RATES: Mapping[int, int] = MappingProxyType(
    {0: 9_600, 1: 57_600, 2: 115_200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000, 7: 4_500_000}
)
"""Rate by code of the register Baud Rate."""

BAUD_CODES: Mapping[int, int] = MappingProxyType({rate: code for code, rate in BAUD_RATES.items()})

WATCHDOG_STEP_S = 0.02
"""One count of the bus watchdog."""

RETURN_DELAY_STEP_S = 2e-6
"""One count of Return Delay Time."""

_HARDWARE_ERRORS: Mapping[int, str] = MappingProxyType(
    {0: "input voltage", 2: "overheating", 3: "encoder", 4: "electrical shock", 5: "overload"}
)


def hardware_error_text(bits: int) -> str:
    """Names of the set bits of Hardware Error Status."""
    names = [name for bit, name in _HARDWARE_ERRORS.items() if bits >> bit & 1]
    return ", ".join(names) if names else f"0x{bits:02X}"
