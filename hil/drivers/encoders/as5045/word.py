"""The 18-bit word of an AS5045: angle and what its status bits mean.

Most significant bit first: D11..D0, OCF, COF, LIN, MagINC, MagDEC, even parity over all 18
(ams AS5045 datasheet).
"""

import math
from collections.abc import Sequence

from hil.core.signals import Status

COUNTS = 4096
_RAD_PER_COUNT = 2.0 * math.pi / COUNTS
_OCF, _COF, _LIN, _MAGNET_RANGE = 0x20, 0x10, 0x08, 0x06


def _meaning(flags: int, yellow_mode: bool) -> Status:
    if not flags & _OCF:
        return Status.STARTING
    if flags & _COF:
        return Status.HARDWARE_ERROR
    if flags & _LIN or (flags & _MAGNET_RANGE == _MAGNET_RANGE and not yellow_mode):
        return Status.MAGNET
    return Status.OK


def _meanings(yellow_mode: bool) -> tuple[tuple[Status, ...], tuple[Status, ...]]:
    """Status by the lower six bits, where the upper twelve have an even and an odd number of ones."""
    known = [_meaning(flags, yellow_mode) for flags in range(64)]
    even, odd = (
        tuple(Status.PARITY if (flags.bit_count() + ones) & 1 else known[flags] for flags in range(64))
        for ones in (0, 1)
    )
    return even, odd


_STATUS = {yellow: _meanings(yellow) for yellow in (False, True)}
_ODD = bytes(counts.bit_count() & 1 for counts in range(COUNTS))
_OK = Status.OK


_ANGLES_RAD = tuple(
    (counts - COUNTS if counts >= COUNTS // 2 else counts) * _RAD_PER_COUNT for counts in range(COUNTS)
)
"""Angle of every count, rad in [-pi, pi)."""


def decode_words(words: Sequence[int], *, yellow_mode: bool) -> tuple[list[float], tuple[Status, ...]]:
    """Decode several words, each as by `decode_word`; -1 stands for a missing word."""
    meanings, ok = _STATUS[yellow_mode], _OK
    angles, statuses = [], []
    for word in words:
        counts = word >> 6
        status = meanings[_ODD[counts]][word & 0x3F] if word >= 0 else Status.TIMEOUT
        angles.append(_ANGLES_RAD[counts] if status is ok else math.nan)
        statuses.append(status)
    return angles, tuple(statuses)


def decode_word(word: int, *, yellow_mode: bool = False) -> tuple[float, Status]:
    """Angle (rad in [-pi, pi), NaN unless OK) and status of a raw word."""
    (angle,), (status,) = decode_words((word,), yellow_mode=yellow_mode)
    return angle, status
