"""The daemon of an emulated fan ends with the emulator, and neither bench nor standby starts another."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from kills import HELD_DUTY, both, daemon_pid, wait_until
from test_daemon_process import emulating, written

from hil.core.clock import MonotonicClock
from hil.fan_daemon import client
from hil.fan_daemon.fallback_client import FailoverClient
from hil.fan_daemon.fan_control import SetPoint
from hil.support.emulated_can_mark import Emulation, Mark, is_emulated

pytestmark = pytest.mark.usefixtures("warm_commands")

STARTS_WITHIN_S = 90.0
ANOTHER_COMES_WITHIN_S = 3.0
"""A bench that misses its daemon starts another after 0.2 s; that one is there within two seconds."""


@pytest.fixture
def kept(wire):
    """(emulator, fan, spec, a bench's link to the fan's daemon, what it says) of a fan that runs."""
    fan, spec = wire
    said = []
    with emulating(spec) as emulator:
        kept = FailoverClient(spec, MonotonicClock(), say=said.append)
        kept.open()
        wait_until(lambda: kept.status().get("report"), "the fan's report")
        kept.set(SetPoint("duty", HELD_DUTY))
        wait_until(lambda: fan.duty == HELD_DUTY, "the set-point")
        yield emulator, fan, spec, kept, said
        kept.close()


def end(emulator):
    emulator.kill()
    emulator.wait()


def test_a_bench_neither_stands_in_for_it_nor_starts_another(kept):
    emulator, fan, spec, kept, said = kept
    end(emulator)
    wait_until(lambda: daemon_pid(spec) is None, "the daemon to end")
    wait_until(kept.trouble, "the loss to be reported")
    since_s = time.time()
    time.sleep(ANOTHER_COMES_WITHIN_S)
    assert daemon_pid(spec) is None
    assert [t_s for t_s, _ in fan.duties() if t_s > since_s] == []
    gone = f"{spec.bus} was emulated and is gone: the fan has no daemon"
    assert said == [gone]
    assert kept.trouble() == gone
    before_s = time.monotonic()
    kept.close()
    assert time.monotonic() - before_s < 1.0


def test_a_bench_that_stands_in_stops_when_the_emulator_ends_too(kept):
    emulator, fan, spec, kept, _ = kept
    for pid in wait_until(lambda: both(spec), "a standby"):
        os.kill(pid, signal.SIGKILL)
    end(emulator)
    wait_until(lambda: "was emulated and is gone" in kept.trouble(), "the end to be reported")
    since_s = time.time()
    time.sleep(ANOTHER_COMES_WITHIN_S)
    assert daemon_pid(spec) is None
    assert [t_s for t_s, _ in fan.duties() if t_s > since_s + 0.1] == []


def test_one_that_is_started_while_the_emulator_ends_does_not_begin(wire):
    _, spec = wire
    said = client.DaemonLaunch(spec, emulated=True).first_line(15.0)
    assert said == {"error": f"{spec.bus} was emulated and is gone"}
    assert daemon_pid(spec) is None
    log = client.log_path(spec)
    wait_until(log.exists, "its log")  # written by a thread of its own
    wait_until(lambda: "so is the daemon" in written(log), "its last word")


def test_only_what_was_emulated_can_be_over():
    name = "udp_multicast:239.74.164.9:1"
    never = Emulation(name)
    mark = Mark(name, 500_000)
    during = Emulation(name)
    assert (never.known, during.known) == (False, True)
    assert not during.is_over()
    mark.close()
    assert during.is_over()
    assert not never.is_over()
    assert Emulation(name, known=True).is_over()


def test_a_name_that_anybody_takes_ends_no_daemon_of_a_real_fan():
    name = "socketcan:can0"
    mark = Mark(name, 500_000)
    said = Emulation(name)
    mark.close()
    assert (said.known, said.is_over(), is_emulated(name)) == (False, False, False)


def daemons_of(state):
    """Process ids of the daemons and standbys that have written logs in a folder, and still live."""
    logs = "".join(path.read_text() for path in state.glob("hil/adhesion-*.log"))
    return {
        pid
        for pid in map(int, re.findall(r"(?:daemon of|standby),? .*?process (\d+)", logs))
        if "hil.fan_daemon" in _command(pid)
    }


def _command(pid):
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")
    except OSError:
        return ""


def children(pid):
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


ENDS = {
    "TERM to all": lambda pid: os.killpg(pid, signal.SIGTERM),
    "TERM to the bench": lambda pid: os.kill(pid, signal.SIGTERM),
    "KILL to all": lambda pid: os.killpg(pid, signal.SIGKILL),
    "KILL to the emulator": lambda pid: os.kill(children(pid)[0], signal.SIGKILL),
}


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "how",
    ["KILL to all", *(pytest.param(how, marks=pytest.mark.long) for how in ENDS if how != "KILL to all")],
)
def test_however_a_session_on_emulated_devices_ends_no_daemon_is_left(how, tmp_path):
    command = [sys.executable, "-m", "hil.cli", "live", "--bench", "emulated", "--no-record"]
    with subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "XDG_STATE_HOME": str(tmp_path)},
    ) as session:
        end_s = time.monotonic() + STARTS_WITHIN_S
        while len(daemons_of(tmp_path)) < 2:
            assert session.poll() is None, session.stderr.read()
            assert time.monotonic() < end_s, "no daemon with a standby"
            time.sleep(0.1)
        ENDS[how](session.pid)
        session.communicate(timeout=60)
    time.sleep(ANOTHER_COMES_WITHIN_S)
    left = daemons_of(tmp_path)
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert left == set()
