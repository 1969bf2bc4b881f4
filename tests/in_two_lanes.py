"""Runs the default tests on two cores: those that wait for a clock, and beside them those in virtual time.

Tests in virtual time keep every core busy, but give way at once to the others, which mostly wait: two of
these at a time, then one after the other those that judge the clock or need a port of the host. What the
lane in virtual time says is shown when the others are through.

    python tests/in_two_lanes.py [FOLDER FOR JUNIT FILES]
"""

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from lanes import ALONE, REAL_TIME, WIRED, files

SIDE_BY_SIDE = ("-n", "2", "--dist", "worksteal")
VIRTUAL = ("virtual", *SIDE_BY_SIDE, "-m", "not long and not real_time and not alone")
ON_A_CLOCK = (
    ("real_time", *SIDE_BY_SIDE, "-m", "not long and real_time", *files(*REAL_TIME, *WIRED)),
    ("alone", "-m", "not long and alone", *files(*ALONE)),
)
HANGING = ("-o", "faulthandler_timeout=960", "-o", "faulthandler_exit_on_timeout=true")
"""A test that no signal reaches, in code of a library say, ends its process and is named as failed."""
_LOOK_S = 0.5


def command(folder, name, *options):
    """One run of pytest."""
    kept = [] if folder is None else ["--junit-xml", f"{folder}/{name}.xml"]
    return [sys.executable, "-m", "pytest", *HANGING, *options, *kept]


def give_way():
    """Run only while nobody else wants the core, where the kernel shares it by sessions, too."""
    os.nice(19)
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    with contextlib.suppress(OSError):
        Path("/proc/self/autogroup").write_text("19")


def show(log, lane):
    """Print what a lane says until it has ended."""
    ended = False
    while not ended:
        ended = lane.poll() is not None
        sys.stdout.write(log.read().decode(errors="replace"))
        sys.stdout.flush()
        if not ended:
            time.sleep(_LOOK_S)


def main(folder=None):
    """Run all of them; returns 1 where a test failed."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "virtual.log"
        with path.open("wb") as written, path.open("rb") as log:
            lane = subprocess.Popen(
                command(folder, *VIRTUAL), stdout=written, stderr=subprocess.STDOUT, start_new_session=True,
                preexec_fn=give_way,
            )  # fmt: skip
            try:
                codes = [subprocess.call(command(folder, *lane_on_a_clock)) for lane_on_a_clock in ON_A_CLOCK]
                show(log, lane)
            finally:
                if lane.poll() is None:
                    lane.terminate()
                codes_of_all = lane.wait()
    return int(any((*codes, codes_of_all)))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
