"""Durations in fixed memory, and what a real-time loop asks of the system and gives back."""

import gc
import os
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.clock import Clock, MonotonicClock
from hil.loop.realtime import RealTime
from hil.loop.timing import Distribution

MS = 1_000_000


class Hand(Clock):
    """A clock that moves when it is asked to."""

    def __init__(self):
        self.t_ns = 0

    def now_ns(self):
        return self.t_ns

    def sleep_until_ns(self, t_ns):
        self.t_ns = max(self.t_ns, t_ns)

    def schedule(self, task, due_ns):
        raise NotImplementedError


@given(st.lists(st.integers(1, 10**10), min_size=1, max_size=300), st.floats(0.01, 1.0))
def test_quantiles_agree_with_sorting_to_one_percent(values, share):
    found = Distribution()
    for value in values:
        found.add(value)
    exact = float(np.quantile(values, share, method="inverted_cdf"))
    assert exact * (1 - 1e-9) <= found.quantile_ns(share) <= exact * 1.0101
    assert found.mean_ns == pytest.approx(np.mean(values))
    assert found.worst_ns == max(values)


def test_the_system_is_left_as_it_was_found():
    before = (gc.isenabled(), sys.getswitchinterval(), os.sched_getscheduler(0), os.sched_getaffinity(0))
    with RealTime(MonotonicClock(), fifo_priority=1, cpu=min(before[3])) as real_time:
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
        assert real_time.warnings or (
            os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
            and os.sched_getaffinity(0) == {min(before[3])}
        )
    assert gc.get_freeze_count() == 0
    assert before == (
        gc.isenabled(),
        sys.getswitchinterval(),
        os.sched_getscheduler(0),
        os.sched_getaffinity(0),
    )


def test_refusals_say_what_to_do_and_stop_nothing():
    with RealTime(MonotonicClock(), fifo_priority=4000, cpu=4000) as real_time:
        text = " ".join(real_time.warnings)
    assert "loop.cpu = 4000 was refused" in text
    assert "ulimit -r 4000" in text


def test_garbage_is_collected_only_in_spare_time():
    clock = Hand()
    with RealTime(clock) as real_time:
        loop = []
        loop.append(loop)
        identity = id(loop)
        del loop
        clock.t_ns += 2000 * MS
        real_time.idle(clock.t_ns + MS)
        assert any(id(o) == identity for o in gc.get_objects())
        real_time.idle(clock.t_ns + 8 * MS)
        assert not any(id(o) == identity for o in gc.get_objects())
        real_time.idle(clock.t_ns + 8 * MS)
        assert real_time.collections == 1
        clock.t_ns += 30_000 * MS
        real_time.idle(clock.t_ns + 9 * MS)
        assert real_time.collections == 2


def test_a_full_collection_that_fits_into_no_cycle_is_left_out():
    clock, kept = Hand(), []
    with RealTime(clock) as real_time:
        kept += [[] for _ in range(20_000)]  # as many as a few hundred records are
        full = gc.get_stats()[2]["collections"]
        for _ in range(2):
            clock.t_ns += 30_000 * MS
            real_time.idle(clock.t_ns + 9 * MS)
        assert real_time.collections == 2
        assert gc.get_stats()[2]["collections"] == full
        clock.t_ns += 30_000 * MS
        real_time.idle(clock.t_ns + 200 * MS)
        assert gc.get_stats()[2]["collections"] == full + 1
