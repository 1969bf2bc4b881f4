"""The AS5045 chip: an angle in, an 18-bit word out, with the errors of a real magnet.

Word, most significant bit first: D11..D0, OCF, COF, LIN, MagINC, MagDEC, even parity over all 18
(ams AS5045 datasheet).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from hil.config.values import Within
from hil.core.geometry import Array
from hil.support.numba_jit import inner, kernel

OCF, COF, LIN, MAG_INC, MAG_DEC = 0x20, 0x10, 0x08, 0x04, 0x02
COUNTS = 4096
START_UP_NS = 20_000_000
_COUNTS_PER_RAD = COUNTS / (2.0 * math.pi)

# Numbers of a chip: amplitude and phase of its error once and twice per turn, noise, sign and zero of its
# mount, how far the magnet has turned in its seat (horn slip); status bits without OCF, set by a magnet that
# is too far or too near, and the counts that it holds.
ONCE, ONCE_PHASE, TWICE, TWICE_PHASE, NOISE, SIGN, ZERO, OFFSET, FLAGS, HELD = range(10)
CHIP_SIZE = 10


Byte = Annotated[int, Within(0, 255, "a byte of a frame")]


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
    firmware: Byte = 1
    layout: Byte = 1


def with_parity(word: int) -> int:
    """The word with its last bit chosen so that the number of ones is even."""
    word &= 0x3FFFE
    return word | (word.bit_count() & 1)


def chip(
    *,
    once: tuple[float, float] = (0.0, 0.0),
    twice: tuple[float, float] = (0.0, 0.0),
    noise_rad: float = 0.0,
    sign: int = 1,
    zero_rad: float = 0.0,
) -> list[float]:
    """Numbers of one chip (`CHIP_SIZE`,).

    Args:
        once: amplitude and phase (rad) of the error of an eccentric magnet, once per turn.
        twice: of that twice per turn.
        noise_rad: standard deviation of the transition noise.
        sign: how the magnet is mounted.
        zero_rad: where its zero lies.
    """
    return [*once, *twice, noise_rad, sign, zero_rad, 0.0, 0.0, 0.0]


@inner
def word(chips: Array, at: int, angle_rad: float, noise: float, more: int) -> int:
    """The word of one chip.

    Args:
        chips: (10 n,), `CHIP_SIZE` numbers of each.
        at: where the chip's numbers begin.
        angle_rad: true angle of the axis.
        noise: a standard normal number.
        more: status bits beside those of the magnet: OCF once it has started.
    """
    theta = chips[at + SIGN] * angle_rad + chips[at + ZERO] + chips[at + OFFSET]
    once = chips[at + ONCE] * math.sin(theta + chips[at + ONCE_PHASE])
    twice = chips[at + TWICE] * math.sin(2.0 * theta + chips[at + TWICE_PHASE])
    seen = theta + once + twice + chips[at + NOISE] * noise
    flags = int(chips[at + FLAGS]) | more
    if not flags & COF:
        chips[at + HELD] = math.floor(seen * _COUNTS_PER_RAD + 0.5) % COUNTS
    bits = int(chips[at + HELD]) << 6 | flags
    ones = bits ^ bits >> 9
    ones ^= ones >> 1 ^ ones >> 2 ^ ones >> 3 ^ ones >> 4 ^ ones >> 5 ^ ones >> 6 ^ ones >> 7 ^ ones >> 8
    return bits | ones & 1


@kernel
def words(
    chips: Array, a_rad: float, b_rad: float, c_rad: float, d_rad: float, noise: Array, row: int, more: int
) -> tuple[int, ...]:
    """Words of four chips whose axes stand so; see `word`.

    Args:
        chips: (4 `CHIP_SIZE`,).
        a_rad: angle of the first axis.
        b_rad: of the second.
        c_rad: of the third.
        d_rad: of the fourth.
        noise: (n, 4 or more) standard normal numbers.
        row: which of them count.
        more: status bits.
    """
    drawn = noise[row]
    return (
        word(chips, 0, a_rad, drawn[0], more),
        word(chips, CHIP_SIZE, b_rad, drawn[1], more),
        word(chips, 2 * CHIP_SIZE, c_rad, drawn[2], more),
        word(chips, 3 * CHIP_SIZE, d_rad, drawn[3], more),
    )
