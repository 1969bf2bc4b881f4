"""Settings of the emulated TF-Luna, as its commands change and show them."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace

from hil_rangefinder import packets as p

_U16, _U32 = struct.Struct("<H"), struct.Struct("<I")
_MEASURED_HZ, _FASTEST_HZ = 500, 250


@dataclass(frozen=True)
class Settings:
    """What the sensor is set to.

    Attributes:
        rate_hz: distances per second; 0 for one at each trigger.
        unit: `p.CENTIMETRES` or `p.MILLIMETRES`.
        baud: of its serial port.
        output: whether it speaks unasked.
    """

    rate_hz: int = 100
    unit: int = p.CENTIMETRES
    baud: int = 115_200
    output: bool = True

    @property
    def unit_m(self) -> float:
        """Length of one count."""
        return 0.01 if self.unit == p.CENTIMETRES else 0.001

    def told(self, command: int, payload: bytes) -> Settings | None:
        """The settings after a command; the same where its value cannot be, None for another command."""
        if command == p.RATE and len(payload) == 2:
            return self._with_rate(*_U16.unpack(payload))
        if command == p.FORMAT and len(payload) == 1:
            known = payload[0] in (p.CENTIMETRES, p.MILLIMETRES)
            return replace(self, unit=payload[0]) if known else self
        if command == p.BAUD and len(payload) == 4:
            (baud,) = _U32.unpack(payload)
            return replace(self, baud=baud) if 9_600 <= baud <= 921_600 else self
        if command == p.OUTPUT and len(payload) == 1:
            return replace(self, output=bool(payload[0]))
        return None

    def _with_rate(self, rate_hz: int) -> Settings:
        """Only rates that its 500 measurements per second can be averaged to are possible."""
        if not rate_hz:
            return replace(self, rate_hz=0)
        possible = int(_MEASURED_HZ / round(_MEASURED_HZ / min(rate_hz, _FASTEST_HZ)))
        return replace(self, rate_hz=possible)

    def shown(self, command: int) -> bytes:
        """Payload of the answer to a command that sets something: its value now."""
        return {
            p.RATE: _U16.pack(self.rate_hz),
            p.FORMAT: bytes((self.unit,)),
            p.BAUD: _U32.pack(self.baud),
            p.OUTPUT: bytes((self.output,)),
        }[command]


FACTORY = Settings()
"""As delivered."""
