"""Trials: benches and daemons killed at random moments, and how long the fan was without a command.

`python docs/make_kill_table.py` runs many of them and writes the table of docs/adhesion.md.
"""

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from hil.core.errors import DeviceError
from hil.fan_daemon import client

STAND_IN = Path(__file__).with_name("bench_stand_in.py")
HELD_DUTY = 0.57
_LONGEST_S = 20.0


@dataclass(frozen=True)
class Kill:
    """One trial: the longest gap between commands around it, and the lowest set-point seen after it."""

    gap_s: float
    lowest_duty: float


def wait_until(true, what):
    end_s = time.monotonic() + _LONGEST_S
    while not (found := true()):
        if time.monotonic() > end_s:
            raise AssertionError(f"not within {_LONGEST_S:g} s: {what}")
        time.sleep(0.01)
    return found


@contextmanager
def bench(spec, duty=HELD_DUTY):
    """A bench that keeps a fan, in a process of its own."""
    command = [sys.executable, str(STAND_IN), spec.to_json(), str(duty)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert "ready" in iter(process.stdout.readline, "").__next__(), "the bench did not start"
            yield process
        finally:
            process.kill()


def daemon_pid(spec):
    """Process id of the fan's daemon; None where there is none."""
    connection = client.connect(spec)
    if connection is None:
        return None
    with connection:
        return client.peer(connection)[0]


def commanded(fan, since_s, times=10):
    """Wait until so many commands have reached the fan."""
    wait_until(lambda: sum(t_s > since_s for t_s, _, _ in list(fan.commands)) >= times, "more commands")


def killed(fan, pids, rng):
    """Kill processes at a random moment, at once, and look at what reached the fan around it."""
    time.sleep(rng.uniform(0.1, 0.6))
    since_s = time.time()
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    commanded(fan, since_s)
    duties = [duty for t_s, duty in fan.duties() if t_s >= since_s]
    before = max((t_s for t_s, _, _ in fan.commands if t_s < since_s), default=since_s)
    return Kill(max(fan.gaps_s(before)), min(duties, default=0.0))


def bench_killed(fan, spec, count, seed):
    """Benches killed while the daemon lives; one after the other at the same fan."""
    rng, kills = random.Random(seed), []
    for _ in range(count):
        with bench(spec) as process:
            reached(fan)
            kills.append(killed(fan, [process.pid], rng))
    return kills


def daemons_killed(fan, spec, count, seed):
    """Daemon and standby killed at once under one bench, after it has had a new pair started."""
    rng, kills, last = random.Random(seed), [], []
    with bench(spec):
        reached(fan)
        for _ in range(count):
            last = wait_until(lambda last=last: new_pair(spec, last), "a new daemon with a standby")
            kills.append(killed(fan, last, rng))
    return kills


def new_pair(spec, last):
    """Process ids of standby and daemon when neither is one of the last."""
    pids = both(spec)
    return [] if set(pids) & set(last) else pids


def both(spec):
    """Process ids of standby and daemon; empty before there are both."""
    pids = keeping_pids(spec)
    return pids if len(pids) == 2 else []


def all_killed(fan, spec, count, seed):
    """Bench, daemon and standby killed at once: seconds until the controller lets go, for each trial."""
    rng, released_s = random.Random(seed), []
    for _ in range(count):
        with bench(spec) as process:
            reached(fan)
            time.sleep(rng.uniform(0.1, 0.6))
            pids = [process.pid, *wait_until(lambda: both(spec), "a standby")]
            since_s = time.time()
            for pid in pids:
                os.kill(pid, signal.SIGKILL)
            wait_until(lambda: fan.duty == 0.0, "the controller's timeout")
            released_s.append(time.time() - since_s)
            fan.commands.clear()
    return released_s


def end_daemon(spec):
    """End the daemon of a trial's fan and its standby: the only way there is."""
    for _ in range(100):
        for pid in keeping_pids(spec):
            assert pid != os.getpid()
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.05)
        if daemon_pid(spec) is None:
            return
    raise AssertionError("the fan has a daemon again and again")


def keeping_pids(spec):
    """Process ids of a fan's daemon and of its standby, as far as there are any."""
    connection = client.connect(spec)
    if connection is None:
        return []
    try:
        with connection:
            status = client.ask(connection, {"do": "status"}, spec)
    except DeviceError:  # it was killed, and hangs up
        return []
    return [pid for pid in (status["standby"], status["pid"]) if pid is not None]


def daemon_alone_killed(fan, spec, count, seed):
    """Daemons killed while no bench is there: each standby goes on, and gets one of its own."""
    rng, kills = random.Random(seed), []
    with bench(spec):
        reached(fan)
    for _ in range(count):
        _, daemon = wait_until(lambda: both(spec), "a standby")
        kills.append(killed(fan, [daemon], rng))
    return kills


def reached(fan):
    wait_until(lambda: abs(fan.duty - HELD_DUTY) < 1e-6, f"duty {HELD_DUTY}")
