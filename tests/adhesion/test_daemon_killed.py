"""Bench or daemon killed at random moments in real time: the fan is never without a command for 200 ms.

Where the daemon's standby is killed as well the bench stands in. It is a busy program, not a small one,
and has half of the controller's timeout.
"""

import os
import signal
import time

import pytest
from kills import (
    HELD_DUTY,
    all_killed,
    bench,
    bench_killed,
    both,
    commanded,
    daemon_alone_killed,
    daemon_pid,
    daemons_killed,
    wait_until,
)

from hil.core.clock import MonotonicClock
from hil.fan_daemon import client
from hil.fan_daemon import fallback_client as failover
from hil.fan_daemon.fallback_client import FailoverClient
from hil.fan_daemon.fan_control import SetPoint
from hil.fan_daemon.server import of_another

MOST_S = 0.2
FEW, MANY = 2, 100


def commanding(fan, spec):
    """A bench that commands the fan, and a list of what it says."""
    said = []
    kept = FailoverClient(spec, MonotonicClock(), say=said.append)
    kept.open()
    wait_until(lambda: kept.status().get("report"), "the fan's report")
    kept.set(SetPoint("duty", HELD_DUTY))
    wait_until(lambda: fan.duty == HELD_DUTY, "the set-point")
    return kept, said


def kill_both(spec):
    """Kill the daemon and its standby."""
    for pid in wait_until(lambda: both(spec), "a standby"):
        os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize("count", [FEW, pytest.param(MANY, marks=pytest.mark.long)])
def test_a_killed_bench_leaves_the_fan_as_it_was(wire, count):
    fan, spec = wire
    kills = bench_killed(fan, spec, count, seed=1)
    assert len(kills) == count
    assert max(kill.gap_s for kill in kills) <= MOST_S
    assert min(kill.lowest_duty for kill in kills) == HELD_DUTY


@pytest.mark.parametrize("count", [FEW, pytest.param(MANY, marks=pytest.mark.long)])
def test_a_bench_stands_in_for_daemon_and_standby_and_replaces_them(wire, count):
    fan, spec = wire
    kills = daemons_killed(fan, spec, count, seed=2)
    assert len(kills) == count
    assert max(kill.gap_s for kill in kills) <= spec.timeout_s / 2
    assert min(kill.lowest_duty for kill in kills) == HELD_DUTY


@pytest.mark.parametrize("count", [FEW, pytest.param(MANY, marks=pytest.mark.long)])
def test_a_daemon_killed_while_no_bench_is_there_has_a_standby(wire, count):
    fan, spec = wire
    kills = daemon_alone_killed(fan, spec, count, seed=4)
    assert len(kills) == count
    assert max(kill.gap_s for kill in kills) <= MOST_S
    assert min(kill.lowest_duty for kill in kills) == HELD_DUTY


def test_all_killed_and_the_controller_lets_go_after_its_time_out(wire):
    fan, spec = wire
    (released_s,) = all_killed(fan, spec, 1, seed=3)
    assert spec.timeout_s - spec.period_s - 0.05 <= released_s <= spec.timeout_s + 0.5


def test_a_bench_that_ends_hands_the_fan_to_a_new_daemon_first(wire):
    fan, spec = wire
    kept, said = commanding(fan, spec)
    since_s = time.time()
    kill_both(spec)
    wait_until(kept.trouble, "the loss to be reported")
    assert "the bench commands the fan itself" in kept.trouble()
    kept.close()
    assert "the fan's daemon has taken over again" in said[-1]
    assert daemon_pid(spec) is not None
    commanded(fan, time.time())
    assert max(fan.gaps_s(since_s)) <= spec.timeout_s / 2
    assert fan.duty == HELD_DUTY


def test_a_bench_goes_on_by_itself_where_the_next_daemon_is_another_users(wire, monkeypatch, caplog):
    """Root starts a daemon just when that of the bench's user dies."""
    fan, spec = wire
    roots = True

    def met(one):
        if roots:
            raise of_another(one, "root", "user robot (1000)")
        return client.connect(one)

    kept, said = commanding(fan, spec)
    since_s = time.time()
    monkeypatch.setattr(failover, "connect", met)
    kill_both(spec)
    ended, refused = "the fan's daemon has ended", "daemon belongs to root, and this program to user robot"
    wait_until(lambda: refused in kept.trouble(), "the other daemon to be reported")
    commanded(fan, time.time())
    assert kept.trouble().startswith(f"{ended}: the bench commands the fan itself; adhesion at ")
    assert [ended in said[0], refused in said[1], len(said)] == [True, True, 2]
    assert daemon_pid(spec) is None
    assert [record for record in caplog.records if record.exc_info] == []
    roots = False
    wait_until(lambda: not kept.trouble(), "a daemon of one's own")
    assert "taken over again" in said[-1]
    kept.close()
    assert max(fan.gaps_s(since_s)) <= spec.timeout_s / 2
    assert fan.duty == HELD_DUTY


def test_a_daemon_that_hangs_is_stood_in_for(wire):
    fan, spec = wire
    with bench(spec) as process:
        wait_until(lambda: fan.duty == HELD_DUTY, "the set-point")
        since_s, pid = time.time(), daemon_pid(spec)
        os.kill(pid, signal.SIGSTOP)
        assert "does not answer" in process.stdout.readline()
        commanded(fan, time.time())
        os.kill(pid, signal.SIGCONT)
        assert "taken over again" in process.stdout.readline()
        assert max(fan.gaps_s(since_s)) <= spec.timeout_s / 2
        assert fan.duty == HELD_DUTY
