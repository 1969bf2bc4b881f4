"""Events in their total order and the state after each one, in preallocated rings.

Order: stamp, sensor id, sequence number, content. Because the state after event k depends on the events
up to k alone, the order of arrival cannot change a bit, as long as a sample is younger than the history.
"""

from __future__ import annotations

import numpy as np

from hil.estimator import layout as L
from hil.estimator.compiled import compiled
from hil.estimator.replay import Ints
from hil.geometry import Array

CAPACITY = 2048


@compiled
def earlier(
    a_ns: int, a_kind: int, a_seq: int, a: Array, b_ns: int, b_kind: int, b_seq: int, b: Array
) -> int:
    """-1, 0 or 1: whether event a comes before b, is the same, or comes after it."""
    if a_ns != b_ns:
        return -1 if a_ns < b_ns else 1
    if a_kind != b_kind:
        return -1 if a_kind < b_kind else 1
    if a_seq != b_seq:
        return -1 if a_seq < b_seq else 1
    for i in range(a.shape[0]):
        x, y = a[i], b[i]
        if x == y or (np.isnan(x) and np.isnan(y)):
            continue
        if np.isnan(x):
            return 1
        if np.isnan(y):
            return -1
        return -1 if x < y else 1
    return 0


@compiled
def insert(
    first: int, count: int, t_ns: Ints, kinds: Ints, seqs: Ints, data: Array,
    new_ns: int, new_kind: int, new_seq: int, new: Array,
) -> int:  # fmt: skip
    """Put one event into the ring of `count` events; its place, or -1 for one that is there already.

    The caller has made room. Event 0 is the base of the history: the new one comes after it.
    """
    capacity = t_ns.shape[0]
    place = count
    while place > 1:
        j = (first + place - 1) % capacity
        order = earlier(new_ns, new_kind, new_seq, new, t_ns[j], kinds[j], seqs[j], data[j])
        if order == 0:
            return -1
        if order > 0:
            break
        place -= 1
    for k in range(count, place, -1):
        i, j = (first + k) % capacity, (first + k - 1) % capacity
        t_ns[i], kinds[i], seqs[i] = t_ns[j], kinds[j], seqs[j]
        data[i] = data[j]
    i = (first + place) % capacity
    t_ns[i], kinds[i], seqs[i] = new_ns, new_kind, new_seq
    data[i] = new
    return place


class History:
    """Ring of events and checkpoints.

    Args:
        span_ns: how far back a sample may lie.
        capacity: largest number of events kept, whatever their rate.
    """

    def __init__(self, span_ns: int, capacity: int = CAPACITY) -> None:
        self.span_ns = span_ns
        self.t_ns = np.zeros(capacity, dtype=np.int64)
        self.kinds = np.zeros(capacity, dtype=np.int64)
        self.seqs = np.zeros(capacity, dtype=np.int64)
        self.data = np.zeros((capacity, L.ROW_DATA))
        self.x = np.zeros((capacity, L.STATES))
        self.p = np.zeros((capacity, L.STATES, L.STATES))
        self.m = np.zeros((capacity, L.MEMORY))
        self.first = self.count = 0

    def reset(self, t_ns: int, x: Array, p: Array, m: Array) -> None:
        """Forget everything and start from one state."""
        self.first, self.count = 0, 1
        self.t_ns[0], self.kinds[0], self.seqs[0] = t_ns, L.RESET, 0
        self.data[0] = 0.0
        self.x[0], self.p[0], self.m[0] = x, p, m

    @property
    def base_ns(self) -> int:
        """Stamp of the oldest state that can be returned to."""
        return int(self.t_ns[self.first])

    @property
    def newest(self) -> int:
        """Ring slot of the newest event."""
        return (self.first + self.count - 1) % len(self.t_ns)

    def trim(self, now_ns: int, room: int) -> None:
        """Let go of events older than the span, and of more where `room` new events would not fit."""
        capacity = len(self.t_ns)
        while self.count > 1:
            second = (self.first + 1) % capacity
            if now_ns - self.t_ns[second] < self.span_ns and self.count + room <= capacity:
                return
            self.first, self.count = second, self.count - 1

    def add(self, t_ns: int, kind: int, seq: int, row: Array) -> int:
        """Insert one event; its place counted from the base, or -1 for a duplicate."""
        if t_ns > self.t_ns[self.newest]:
            i = (self.first + self.count) % len(self.t_ns)
            self.t_ns[i], self.kinds[i], self.seqs[i], self.data[i] = t_ns, kind, seq, row
            self.count += 1
            return self.count - 1
        place = insert(
            self.first, self.count, self.t_ns, self.kinds, self.seqs, self.data, t_ns, kind, seq, row
        )
        self.count += place > 0
        return place
