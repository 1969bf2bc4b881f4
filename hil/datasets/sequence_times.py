"""Puts the stamps of a periodic source back on its period, by its sequence numbers.

A source that samples at a fixed rate and numbers its messages may stamp them when they are sent, some tens
of milliseconds late, each by another delay. Sequence numbers times the period give the times at which it
sampled, up to an offset that changes slowly with its clock.
"""

import numpy as np

from hil.core.geometry import Array

_REACH = 100
_LATE_S, _PERIODS = 1e-3, 4.0
_COUNTED = 0.9


def on_period(t_s: Array, sequence: Array) -> Array:
    """Times (n,), s, of messages by their sequence numbers; the same array where these show no period.

    The offset of a message is the median over 200 messages of the earliest stamp within 200. Stamps are
    changed where they are typically more than a millisecond late, and nine in ten less than four periods.

    Args:
        t_s: (n,) stamps as in the file, s.
        sequence: (n,) numbers of the messages; a lost message leaves a number out.
    """
    good = np.isfinite(t_s) & np.isfinite(sequence)
    if np.count_nonzero(good) < 4 * _REACH or np.any(np.diff(sequence[good]) < 1.0):
        return t_s
    number, stamps_s = sequence[good] - sequence[good][0], t_s[good]
    spans_s, spans = (values[_REACH:] - values[:-_REACH] for values in (stamps_s, number))
    period_s = float(np.median(spans_s / spans))
    behind_s = stamps_s - period_s * number
    earliest_s = _windows(behind_s).min(axis=1)
    regular_s = period_s * number + np.median(_windows(earliest_s), axis=1)
    late_s = stamps_s - regular_s
    if np.median(late_s) < _LATE_S or np.mean(np.abs(late_s) < _PERIODS * period_s) < _COUNTED:
        return t_s
    out = np.array(t_s, dtype=np.float64)
    out[good] = regular_s + np.median(late_s)
    return out


def _windows(values: Array) -> Array:
    """Windows (n, 2 k + 1) of values (n,) about each of them, cut at the ends."""
    padded = np.pad(values, _REACH, mode="edge")
    windows: Array = np.lib.stride_tricks.sliding_window_view(padded, 2 * _REACH + 1)
    return windows
