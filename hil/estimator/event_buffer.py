"""Ring buffers of events in a fixed total order, with the filter state after each event.

Order: stamp, number of the sensor, sequence number, content. The state after event k depends only on the
events up to k. So the order of arrival does not change a single bit, as long as every sample is newer than
the start of the history.
"""

import numpy as np

from hil.core.geometry import Array
from hil.core.named_records import Ints, Records, floats
from hil.estimator.kernel_layout import MEMORY, ROW, Events, Samples, States
from hil.estimator.matrix_loops import put
from hil.estimator.measurement_queue import Batch
from hil.estimator.sensors import MARK
from hil.estimator.state_vector import STATES
from hil.support.numba_jit import inner, kernel, plain

CAPACITY = 2048
FIRST, COUNT, LATE, DUPLICATE = range(4)


@inner
def earlier(
    a_ns: int, a_number: int, a_seq: int, a: Array, b_ns: int, b_number: int, b_seq: int, b: Array
) -> int:
    """Compare event a with event b, rows (n,): -1 where a comes first, 0 where they are the same, else 1."""
    if a_ns != b_ns:
        return -1 if a_ns < b_ns else 1
    if a_number != b_number:
        return -1 if a_number < b_number else 1
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


@inner
def insert(marks: Ints, ring: Samples, new: Samples, n: int) -> int:
    """Insert sample `n` of `new` into the ring; return its place, or -1 for a duplicate.

    The caller has made room. Event 0 is the base of the history; a new event is always placed after it.
    """
    t_ns, numbers, seqs, data = ring
    new_ns, new_number, new_seq, added = new[0][n], new[1][n], new[2][n], new[3][n]
    first, capacity = marks[FIRST], t_ns.shape[0]
    place = int(marks[COUNT])
    while place > 1:
        j = (first + place - 1) % capacity
        order = earlier(new_ns, new_number, new_seq, added, t_ns[j], numbers[j], seqs[j], data[j])
        if order == 0:
            return -1
        if order > 0:
            break
        place -= 1
    for k in range(marks[COUNT], place, -1):
        i, j = (first + k) % capacity, (first + k - 1) % capacity
        t_ns[i], numbers[i], seqs[i] = t_ns[j], numbers[j], seqs[j]
        put(data[i], data[j])
    i = (first + place) % capacity
    t_ns[i], numbers[i], seqs[i] = new_ns, new_number, new_seq
    put(data[i], added)
    return place


@inner
def drop_old(marks: Ints, t_ns: Ints, span_ns: int, now_ns: int, room: int) -> None:
    """Drop events older than the span, and further old ones until `room` new events fit."""
    capacity = t_ns.shape[0]
    now_ns = max(now_ns, t_ns[(marks[FIRST] + marks[COUNT] - 1) % capacity])
    while marks[COUNT] > 1:
        second = (marks[FIRST] + 1) % capacity
        if now_ns - t_ns[second] < span_ns and marks[COUNT] + room <= capacity:
            return
        marks[FIRST] = second
        marks[COUNT] -= 1


@inner
def in_order(t_ns: Ints, number: int) -> Ints:
    """Indices that sort the first `number` stamps; equal stamps keep their order.

    A cycle brings few samples, nearly in order: insertion sort is as fast as any here and compiles quickly.
    """
    order = np.zeros(number, np.int64)
    for k in range(number):
        place = k
        while place > 0 and t_ns[order[place - 1]] > t_ns[k]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = k
    return order


@kernel
def enter(marks: Ints, ring: Samples, span_ns: int, now_ns: int, number: int, new: Samples) -> int:
    """Put a cycle's samples into the ring, oldest first; return the first place to replay from.

    Args:
        marks: (4,) first slot, number of events, refused as late, refused as duplicates; changed in place.
        ring: the samples in the ring, changed in place.
        span_ns: largest age of a sample.
        now_ns: time of the cycle.
        number: number of new samples.
        new: the new samples, in any order.
    """
    (t_ns, numbers, seqs, data), (new_ns, new_numbers, new_seqs, new_data) = ring, new
    capacity = t_ns.shape[0]
    drop_old(marks, t_ns, span_ns, now_ns, number)
    begin = int(marks[COUNT])
    order = in_order(new_ns, number)
    for k in range(number):
        n, newest = order[k], (marks[FIRST] + marks[COUNT] - 1) % capacity
        if new_ns[n] <= t_ns[marks[FIRST]] or number - k > capacity - marks[COUNT]:
            marks[LATE] += 1
            continue
        place = marks[COUNT]
        if new_ns[n] > t_ns[newest]:
            i = (newest + 1) % capacity
            t_ns[i], numbers[i], seqs[i] = new_ns[n], new_numbers[n], new_seqs[n]
            put(data[i], new_data[n])
        else:
            place = insert(marks, ring, new, n)
        if place < 0:
            marks[DUPLICATE] += 1
        else:
            marks[COUNT] += 1
            begin = min(begin, int(place))
    return begin


class History:
    """Ring of events with a checkpoint (state, covariance, memory) after each.

    Args:
        span_ns: largest age of a sample.
        capacity: largest number of events kept, whatever their rate.

    Attributes:
        t_ns, numbers, seqs: (capacity,) stamps, sensor numbers, sequence numbers.
        rows: (capacity,) samples.
        x, p, m: state (capacity, 20), covariance (capacity, 20, 20) and memory (capacity,) after each event.
        marks: (4,) first slot, number of events, refused as late, refused as duplicates.
        events, states: the same arrays in the form that `hil.estimator.event_loop.run` takes.
    """

    def __init__(self, span_ns: int, capacity: int = CAPACITY) -> None:
        self.span_ns = span_ns
        self.t_ns = np.zeros(capacity, dtype=np.int64)
        self.numbers = np.zeros(capacity, dtype=np.int64)
        self.seqs = np.zeros(capacity, dtype=np.int64)
        self.rows: Records = np.zeros(capacity, ROW)
        self._ring = Samples(self.t_ns, self.numbers, self.seqs, floats(self.rows))
        self.x = np.zeros((capacity, STATES))
        self.p = np.zeros((capacity, STATES, STATES))
        self.m: Records = np.zeros(capacity, MEMORY)
        self.marks = np.zeros(4, dtype=np.int64)
        self.events = Events(self.marks, self.t_ns, self.numbers, self.rows)
        self.states = States(self.x, self.p, self.m)
        self._marks, self._stamps = self.marks.data, self.t_ns.data

    def reset(self, t_ns: int, x: Array, p: Array, m: Records) -> None:
        """Drop all events and start from one state (20,), covariance (20, 20) and memory (1,)."""
        self.marks[:] = 0, 1, 0, 0
        self.t_ns[0], self.numbers[0], self.seqs[0] = t_ns, MARK, 0
        self._ring.data[0] = 0.0
        self.x[0], self.p[0], self.m[0] = x, p, m[0]

    @property
    def first(self) -> int:
        """Ring slot of event 0, the base."""
        first: int = self._marks[FIRST]
        return first

    @property
    def count(self) -> int:
        """Number of events, including the base."""
        count: int = self._marks[COUNT]
        return count

    @property
    def base_ns(self) -> int:
        """Stamp of the base: the oldest state that the filter can rewind to."""
        base_ns: int = self._stamps[self._marks[FIRST]]
        return base_ns

    @property
    def newest(self) -> int:
        """Ring slot of the newest event."""
        return (self.first + self.count - 1) % len(self.t_ns)

    def enter(self, staged: Batch, now_ns: int) -> int:
        """Put a cycle's samples in; return the first place to replay from, `count` when nothing is new."""
        ring, new = plain(self._ring), plain(staged.samples)
        return int(enter(self.marks, ring, self.span_ns, now_ns, staged.count, new))
