"""A bench that drives up and down a wall for ever, until it is killed."""

import sys

from hil.bench import open_bench
from hil.robot.trajectories import line


def main():
    with open_bench(sys.argv[1]) as bench:
        pose = bench.settle()
        there = pose + [0.05, 0.0, 0.0]
        sys.stdout.write("driving\n")
        sys.stdout.flush()
        while True:
            bench.drive(line(pose, there), start_pose=pose, hold_s=0.0)
            pose, there = there, pose


if __name__ == "__main__":
    main()
