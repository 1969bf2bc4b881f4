"""The AS5045 chip: an angle in, an 18-bit word out, with the errors of a real magnet.

Word, most significant bit first: D11..D0, OCF, COF, LIN, MagINC, MagDEC, even parity over all 18
(ams AS5045 datasheet).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from math import floor, sin

OCF, COF, LIN, MAG_INC, MAG_DEC = 0x20, 0x10, 0x08, 0x04, 0x02
COUNTS = 4096
START_UP_NS = 20_000_000
_COUNTS_PER_RAD = COUNTS / (2.0 * math.pi)
_ODD = bytes(bits.bit_count() & 1 for bits in range(COUNTS))
"""Whether the number of ones is odd."""


@dataclass(frozen=True)
class EncoderTruthOptions:
    """True imperfections; standard deviations of what is drawn from the world's seed.

    Attributes:
        noise_rad: transition noise, 0.06 degrees rms in fast mode.
        once_rad, twice_rad: amplitude of the once- and twice-per-turn error of an eccentric magnet.
        firmware, layout: what the node says of its firmware and of the layout of its frames.
    """

    noise_rad: float = math.radians(0.06)
    once_rad: float = math.radians(0.3)
    twice_rad: float = math.radians(0.1)
    firmware: int = 1
    layout: int = 1


def with_parity(word: int) -> int:
    """The word with its last bit chosen so that the number of ones is even."""
    word &= 0x3FFFE
    return word | (word.bit_count() & 1)


class As5045Chip:
    """One encoder chip.

    Attributes:
        flags: status bits without OCF; set by a magnet that is too far or too near.
        offset_rad: how far the magnet has turned in its seat (horn slip).
    """

    def __init__(
        self,
        *,
        once: tuple[float, float] = (0.0, 0.0),
        twice: tuple[float, float] = (0.0, 0.0),
        noise_rad: float = 0.0,
        sign: int = 1,
        zero_rad: float = 0.0,
    ) -> None:
        """`once` and `twice` are (amplitude rad, phase rad) of the eccentricity error."""
        self._errors = (*once, *twice, noise_rad)
        self._sign, self._zero_rad = sign, zero_rad
        self.flags = 0
        self.offset_rad = 0.0
        self._held = 0

    def word(self, angle_rad: float, noise: float, started: bool = True) -> int:
        """The word for a true axis angle; `noise` is a standard normal number."""
        theta = self._sign * angle_rad + self._zero_rad + self.offset_rad
        a1, p1, a2, p2, sigma = self._errors
        seen = theta + a1 * sin(theta + p1) + a2 * sin(2.0 * theta + p2) + sigma * noise
        flags = self.flags
        if not flags & COF:
            self._held = floor(seen * _COUNTS_PER_RAD + 0.5) % COUNTS
        held = self._held
        if started:
            flags |= OCF
        return held << 6 | flags | (_ODD[held] ^ _ODD[flags])
