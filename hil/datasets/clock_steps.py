"""Splits a recording where its stamps step back, because the clock was set.

Rows in the wrong order are sorted; they fill times at which no other row is. Rows after a step back lie
between rows that exist already: sorting them would mix two times.
"""

from itertools import pairwise

import numpy as np

from hil.core.errors import DataError
from hil.core.geometry import Array
from hil.datasets.cleaning import Log, dips, most_dips, without_stamp
from hil.datasets.truth_jumps import Rows

_FEWEST_TAKEN, _TAKEN = 2, 0.5
_REGULAR = 1.5


def split(where: str, wheels: Log, truth: Log) -> list[tuple[Log, Log]]:
    """Split the logs at each step back of their stamps; a log without one stays as it is.

    Args:
        where: the file, for messages.
        wheels: wheel rows in the order of the file.
        truth: ground-truth rows in the order of the file.

    Raises:
        DataError: the logs step back a different number of times.
    """
    by_wheels, by_truth = _begins(wheels), _begins(truth)
    if len(by_wheels) > len(by_truth):
        by_truth = _dips(truth)
    elif len(by_wheels) < len(by_truth):
        by_wheels = _dips(wheels)
    if len(by_wheels) != len(by_truth):
        raise DataError(
            where,
            f"the stamps of the wheels step back {len(by_wheels)} times, those of the ground truth "
            f"{len(by_truth)} times: behind that they have no common time",
            expected="wheels and ground truth on one clock",
            remedy="cut the recording there",
        )
    return list(zip(_parts(wheels, by_wheels), _parts(truth, by_truth), strict=True))


def in_words(log: Log) -> str:
    """Description of the first step back of a split log, for a message."""
    first = _begins(log) or _dips(log)
    before_s, behind_s = log.t_s[: first[0]], log.t_s[first[0]]
    return (
        f"step back of its stamps (the first by {np.nanmax(before_s) - behind_s:.2f} s, "
        f"{np.nanmax(before_s) - np.nanmin(before_s):.1f} s after its begin): what follows is a recording of "
        "its own"
    )


def _usable(log: Log) -> Rows:
    return np.flatnonzero(np.isfinite(log.t_s) & ~without_stamp(log.t_s))


def _begins(log: Log) -> list[int]:
    rows = _usable(log)
    return [int(rows[k]) for k in step_backs(log.t_s[rows], log.values[rows])]


def _dips(log: Log) -> list[int]:
    """Indices of rows whose stamp is before that of the row before."""
    rows = _usable(log)
    return [int(k) for k in rows[dips(log.t_s[rows])]]


def _parts(log: Log, begins: list[int]) -> list[Log]:
    edges = [0, *begins, len(log.t_s)]
    receive_s = log.receive_s
    return [
        Log(log.t_s[a:b], log.values[a:b], None if receive_s is None else receive_s[a:b])
        for a, b in pairwise(edges)
    ]


def step_backs(t_s: Array, values: Array) -> list[int]:
    """Indices of rows at which stamps step back; empty where the rows have no time order at all.

    After a step back at least two rows must lie within the times of rows before, without being copies of
    them.

    Args:
        t_s: (n,) stamps in the order of the file, s.
        values: (n, k) values of the rows.
    """
    lower = dips(t_s)
    if not len(lower) or len(lower) > most_dips(t_s):
        return []
    typical_s = float(np.median(np.abs(np.diff(t_s))))
    begins, begin = [], 0
    for dip in lower.tolist():
        before = np.sort(t_s[begin:dip])
        behind = np.flatnonzero(t_s[dip:] >= before[-1])
        later = np.arange(dip, dip + int(behind[0]) if len(behind) else len(t_s))
        taken = _taken(t_s, values, later, before, typical_s, begin)
        if taken >= max(_FEWEST_TAKEN, _TAKEN * len(later)):
            begins.append(dip)
            begin = dip
    return begins


def _taken(t_s: Array, values: Array, later: Rows, before: Array, typical_s: float, begin: int) -> int:
    """Number of later rows that lie within densely filled times of the rows before, sorted (m,)."""
    at = np.searchsorted(before, t_s[later])
    inside = (at > 0) & (at < len(before))
    close = np.zeros(len(later), dtype=bool)
    close[inside] = before[at[inside]] - before[at[inside] - 1] <= _REGULAR * typical_s
    if not close.any():
        return 0
    earlier = slice(begin, int(later[0]))
    copies = np.isin(t_s[later], t_s[earlier])
    for k in np.flatnonzero(copies & close):
        twin = int(np.flatnonzero(t_s[earlier] == t_s[later[k]])[0]) + begin
        close[k] = not np.array_equal(values[twin], values[later[k]], equal_nan=True)
    return int(np.count_nonzero(close))
