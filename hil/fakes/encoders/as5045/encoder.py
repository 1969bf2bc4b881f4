"""The AS5045 encoder chip: angle in, 18-bit word out, with the errors of a real magnet.

Word, most significant bit first: D11..D0, OCF, COF, LIN, MagINC, MagDEC, even parity over all 18
(ams AS5045 datasheet).
"""

import math
from dataclasses import dataclass
from typing import Annotated

from hil.config.field_types import Within
from hil.core.geometry import Array
from hil.support.numba_jit import inner, kernel

OCF, COF, LIN, MAG_INC, MAG_DEC = 0x20, 0x10, 0x08, 0x04, 0x02
COUNTS = 4096
START_UP_NS = 20_000_000
_COUNTS_PER_RAD = COUNTS / (2.0 * math.pi)

# Numbers of a chip: amplitude and phase of its error once and twice per turn, noise, sign and zero of its
# mount, rotation of the magnet in its seat (horn slip); status bits without OCF, of a magnet too far or near;
# and the last valid counts.
ONCE, ONCE_PHASE, TWICE, TWICE_PHASE, NOISE, SIGN, ZERO, OFFSET, FLAGS, HELD = range(10)
CHIP_SIZE = 10


Byte = Annotated[int, Within(0, 255, "a byte of a frame")]


@dataclass(frozen=True)
class EncoderTruthOptions:
    """True imperfections; standard deviations of what is drawn from the world's seed.

    Attributes:
        noise_rad: transition noise, 0.06 degrees rms in fast mode.
        once_rad, twice_rad: amplitude of the once- and twice-per-turn error of an eccentric magnet.
        firmware, layout: version of its firmware and of its frame layout that the node reports.
    """

    noise_rad: float = math.radians(0.06)
    once_rad: float = math.radians(0.3)
    twice_rad: float = math.radians(0.1)
    firmware: Byte = 1
    layout: Byte = 1


def with_parity(word: int) -> int:
    """Return the word with its last bit set to even parity."""
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
    """Return the numbers of one chip (`CHIP_SIZE`,).

    Args:
        once: amplitude and phase (rad) of the error of an eccentric magnet, once per turn.
        twice: the same for the error twice per turn.
        noise_rad: standard deviation of the transition noise.
        sign: sign, 1 or -1, of the direction in which the magnet is mounted.
        zero_rad: chip angle at joint angle 0.
    """
    return [*once, *twice, noise_rad, sign, zero_rad, 0.0, 0.0, 0.0]


@inner
def word(chips: Array, at: int, angle_rad: float, noise: float, more: int) -> int:
    """Return the word of one chip.

    Args:
        chips: numbers (10 n,) of the chips, `CHIP_SIZE` each.
        at: index of the chip's first number.
        angle_rad: true angle of the axis.
        noise: a standard normal random number.
        more: further status bits: OCF once the chip has started.
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
    """Return the words of four chips; see `word`.

    Args:
        chips: numbers (4 `CHIP_SIZE`,) of the chips.
        a_rad: angle of the first axis.
        b_rad: angle of the second axis.
        c_rad: angle of the third axis.
        d_rad: angle of the fourth axis.
        noise: (n, 4 or more) standard normal random numbers.
        row: row of `noise` to use.
        more: further status bits.
    """
    drawn = noise[row]
    return (
        word(chips, 0, a_rad, drawn[0], more),
        word(chips, CHIP_SIZE, b_rad, drawn[1], more),
        word(chips, 2 * CHIP_SIZE, c_rad, drawn[2], more),
        word(chips, 3 * CHIP_SIZE, d_rad, drawn[3], more),
    )
