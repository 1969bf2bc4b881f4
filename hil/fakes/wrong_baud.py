"""What a UART makes of bytes that were sent at another baud rate than its own: noise, the same every time."""

from __future__ import annotations

TOLERANCE = 0.03
"""Share by which two rates may differ and still be understood: well within half a bit of ten."""
_BITS = 8
_MIDDLE = 0.5


def same_rate(one: float, other: float) -> bool:
    """Whether a receiver at one rate understands a sender at the other."""
    return abs(one - other) <= TOLERANCE * max(one, other)


def heard(data: bytes, sent_baud: float, own_baud: float) -> bytes:
    """The bytes that a receiver reads.

    It begins with each falling edge and looks at the line in the middle of each of its own bits: one that
    starts, eight of data, the lowest first, one that stops. A byte without its stop bit is kept, as it came.

    Args:
        data: sent one after the other, without pauses; the line rests (1) before and after.
        sent_baud: bits per second of the sender.
        own_baud: of the receiver.
    """
    levels = [level for byte in data for level in (0, *(byte >> k & 1 for k in range(_BITS)), 1)]
    step = sent_baud / own_baud
    out = bytearray()
    at, last = 0.0, 1
    while at < len(levels):
        level = levels[int(at)]
        if not (last == 1 and level == 0):
            last, at = level, float(int(at) + 1)
            continue
        bits = [_level(levels, at + step * (k + 1 + _MIDDLE)) for k in range(_BITS)]
        out.append(sum(bit << k for k, bit in enumerate(bits)))
        at += step * (_BITS + 1 + _MIDDLE)
        last = _level(levels, at)
    return bytes(out)


def _level(levels: list[int], at: float) -> int:
    return levels[int(at)] if at < len(levels) else 1
