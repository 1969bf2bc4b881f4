"""A bench that drives up and down a wall until it is killed; stopped by a busy computer, it begins again.

Arguments: its bench file, `patient` for a busy computer, and faults of its real devices.

SIGUSR1 sets the time of day forward by an hour, for this process: nothing that drives may go by it.
"""

import signal
import sys
import time

import numpy as np

from hil.bench import open_bench
from hil.core.errors import HilError
from hil.robot.trajectories import line
from tests import patience

PATIENT = {"servos.reply_slack_s": 0.02, "servos.retry_budget_s": 0.02, "imu.reply_timeout_s": 0.04}
if "patient" in sys.argv:
    PATIENT |= patience.PATIENT
"""A busy computer is no silent device."""
ATTEMPTS = 20
STEP_S = 3600.0


def set_the_clock(*_):
    """Let the time of day leap."""
    now, now_ns = time.time, time.time_ns
    time.time = lambda: now() + STEP_S
    time.time_ns = lambda: now_ns() + round(STEP_S * 1e9)


def main():
    signal.signal(signal.SIGUSR1, set_the_clock)
    for _ in range(ATTEMPTS):
        try:
            faults = [word for word in sys.argv[2:] if word != "patient"]
            with open_bench(sys.argv[1], overrides=PATIENT, faults=faults, inject_real=True) as bench:
                drive_for_ever(bench)
        except HilError as error:
            sys.stderr.write(f"{error}\n")


def drive_for_ever(bench):
    sys.stdout.write("driving\n")
    sys.stdout.flush()
    while True:
        try:
            drive(bench)
        except HilError as error:
            sys.stderr.write(f"{error}\n")


def drive(bench):
    pose = bench.settle()
    there = np.add(pose, (0.05, 0.0, 0.0))
    while True:
        bench.drive(line(pose, there), start_pose=pose, hold_s=0.0)
        pose, there = there, pose


if __name__ == "__main__":
    main()
