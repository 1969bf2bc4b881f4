"""Runs the default tests on two cores: those that wait for a clock, and beside them those in virtual time.

Tests in virtual time keep every core busy, but give way at once to the others, which mostly wait: two of
these at a time, then one after the other those that judge the clock or need a port of the host. When the
others are through, the lane in virtual time gives way no longer, and what it says is shown.

Each lane has a session of its own: a terminal that is closed reaches no test, and under `nohup` the run goes
on. Ctrl-C, SIGTERM and, without `nohup`, SIGHUP end all of them.

    python tests/in_two_lanes.py [FOLDER FOR JUNIT FILES]
"""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from lanes import ALONE, REAL_TIME, WIRED, files

SIDE_BY_SIDE = ("-n", "2", "--dist", "worksteal")
VIRTUAL = ("virtual", *SIDE_BY_SIDE, "-m", "not long and not real_time and not alone")
ON_A_CLOCK = (
    ("real_time", *SIDE_BY_SIDE, "-m", "not long and real_time", *files("real_time", *REAL_TIME, *WIRED)),
    ("alone", "-m", "not long and alone", *files("alone", *ALONE)),
)
HANGING = ("-o", "faulthandler_timeout=960", "-o", "faulthandler_exit_on_timeout=true")
"""A test that no signal reaches, in code of a library say, ends its process and is named as failed."""
_LOOK_S = 0.5
_ENDING_S = 20.0


def command(folder, name, *options):
    """One run of pytest."""
    kept = [] if folder is None else ["--junit-xml", f"{folder}/{name}.xml"]
    return [sys.executable, "-m", "pytest", *HANGING, *options, *kept]


def give_way():
    """Run only while no other process wants the core, where the kernel shares it by sessions, too."""
    os.nice(19)
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    with contextlib.suppress(OSError):
        Path("/proc/self/autogroup").write_text("19")


def take_turns(lane):
    """Share the cores with other programs again, where the kernel shares them by sessions."""
    with contextlib.suppress(OSError):
        Path(f"/proc/{lane.pid}/autogroup").write_text("0")


def show(log, lane):
    """Print what a lane says until it has ended."""
    ended = False
    while not ended:
        ended = lane.poll() is not None
        sys.stdout.write(log.read().decode(errors="replace"))
        sys.stdout.flush()
        if not ended:
            time.sleep(_LOOK_S)


def start(lane, **how):
    """A lane that no signal of the terminal reaches."""
    return subprocess.Popen(lane, start_new_session=True, **how)


def end(lane):
    """End a lane with all that it has started, if it still runs."""
    if lane.poll() is None:
        os.killpg(lane.pid, signal.SIGINT)
        try:
            lane.wait(_ENDING_S)
        except subprocess.TimeoutExpired:
            os.killpg(lane.pid, signal.SIGKILL)
    return lane.wait()


def leave(number, _frame):
    """What ends this process ends it in order."""
    sys.exit(128 + number)


def main(folder=None):
    """Run all of them; returns 1 where a test failed."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, leave)
    with tempfile.TemporaryDirectory() as scratch, contextlib.ExitStack() as lanes:
        path = Path(scratch) / "virtual.log"
        with path.open("wb") as written, path.open("rb") as log:
            virtual = start(
                command(folder, *VIRTUAL), stdout=written, stderr=subprocess.STDOUT, preexec_fn=give_way
            )
            lanes.callback(end, virtual)
            codes = []
            for options in ON_A_CLOCK:
                lane = start(command(folder, *options))
                lanes.callback(end, lane)
                codes.append(lane.wait())
            take_turns(virtual)
            show(log, virtual)
    return int(any((*codes, virtual.wait())))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
