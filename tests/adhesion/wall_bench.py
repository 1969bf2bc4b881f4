"""A bench that drives up and down a wall until it is killed; stopped by a busy computer, it begins again."""

import sys

import numpy as np

from hil.bench import open_bench
from hil.robot.trajectories import line
from hil.vocabulary.errors import HilError


def main():
    with open_bench(sys.argv[1]) as bench:
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
