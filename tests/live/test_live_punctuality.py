"""Durations in fixed memory, and what a real-time loop asks of the system and gives back."""

import gc
import os
import resource
import subprocess
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
        os.sched_getscheduler(0) & ~(0 if os.geteuid() == 0 else os.SCHED_RESET_ON_FORK),
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


AS_ANYONE = """
import gc, os, sys
from hil.core.clock import MonotonicClock
from hil.loop.realtime import RealTime

before, policy = (os.sched_getaffinity(0), sys.getswitchinterval()), os.sched_getscheduler(0)
with RealTime(MonotonicClock(), fifo_priority=1, cpu=min(before[0])) as real_time:
    assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO, real_time.warnings
    if os.geteuid() == 0:
        os.setgroups([])
        os.setresgid(65534, 65534, 65534)
        os.setresuid(65534, 65534, 65534)
assert os.sched_getscheduler(0) == policy | os.SCHED_RESET_ON_FORK
assert before == (os.sched_getaffinity(0), sys.getswitchinterval())
assert gc.isenabled() and gc.get_freeze_count() == 0
"""


@pytest.mark.skipif(
    os.geteuid() != 0 and resource.getrlimit(resource.RLIMIT_RTPRIO)[1] < 1,
    reason="neither root nor a user with a real-time priority (ulimit -r)",
)
def test_an_ordinary_user_gets_everything_back_but_the_flag_that_only_root_may_clear():
    """A PermissionError at the end had kept the affinity, the collector and the interval as they were."""
    done = subprocess.run(
        [sys.executable, "-c", AS_ANYONE], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_a_setting_that_cannot_be_put_back_does_not_keep_the_others(monkeypatch, caplog):
    """As of a policy of seccomp, or of systemd's RestrictRealtime, that came meanwhile."""
    interval = sys.getswitchinterval()
    with RealTime(MonotonicClock(), cpu=min(os.sched_getaffinity(0))):
        real, denied = os.setpriority, PermissionError(1, "Operation not permitted")

        def refuse(*_):
            raise denied

        monkeypatch.setattr(os, "setpriority", refuse)
        monkeypatch.setattr(os, "sched_setaffinity", refuse)
    assert (gc.get_freeze_count(), gc.isenabled(), sys.getswitchinterval()) == (0, True, interval)
    assert caplog.text.count("could not be put back") >= 1
    monkeypatch.undo()
    assert os.setpriority is real
