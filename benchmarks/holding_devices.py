"""What fan, propellers and load cells cost: the same drive with and without them, turn by turn in one run.

    python benchmarks/holding_devices.py                       # 4 turns of 8 s, each with and without
    python benchmarks/holding_devices.py --turns 8 --seconds 20 --only virtual

`virtual` is processor time of a climb with EKF and supervisor in virtual time, devices' chips and physics
included. `live` is processor time of the loop's thread in real time, with the emulated robot in a process of
its own; `process` is that of the whole program, with the threads that read the CAN buses and look after the
keeper. The drives of a turn follow each other, so that whatever else the machine does meets both; a share is
the median over the turns. `--fifo 20` lets loop and emulator go before everything else (root).
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import hil
from hil.robot.trajectories import line
from hil.vocabulary.errors import HilError

DEVICES = ("adhesion", "thrust", "load_cells")
MOST = {"virtual": 0.15, "live": 0.05}
_CLIMB_M_S = 0.02
_TRIES = 5


def climb(
    seconds: float, seed: int, *, whole: bool, fifo: int | None = None, **how: bool
) -> dict[str, float]:
    """One drive: processor time of the program and of the loop's thread, ms of a cycle."""
    overrides: dict[str, Any] = {} if whole else dict.fromkeys(DEVICES)
    if fifo:
        overrides["loop.fifo_priority"] = fifo
    with hil.open_bench("emulated", seed=seed, overrides=overrides, **how) as bench:
        pose = bench.settle()
        there = (pose[0] + _CLIMB_M_S * seconds, pose[1], pose[2])
        process_s, thread_s = time.process_time(), time.thread_time()
        motion = bench.drive(line(pose, there, duration_s=seconds), start_pose=pose, hold_s=0.0)
        process_s, thread_s = time.process_time() - process_s, time.thread_time() - thread_s
        cycles = len(motion.records)
        return {"process_ms": 1e3 * process_s / cycles, "loop_ms": 1e3 * thread_s / cycles}


Turn = dict[str, dict[str, float]]


def take(turns: int, one: Callable[[int, bool], dict[str, float]]) -> list[Turn]:
    """Both drives of each turn, `with` and `without` the three devices, first one and then the other."""
    orders = (("with", "without"), ("without", "with"))
    return [{name: again(one, turn, name == "with") for name in orders[turn % 2]} for turn in range(turns)]


def again(one: Callable[[int, bool], dict[str, float]], turn: int, whole: bool) -> dict[str, float]:
    """One drive; where a machine that is busy elsewhere has stopped the robot, another."""
    for _ in range(_TRIES):
        try:
            return one(turn, whole)
        except HilError as error:
            print(error, file=sys.stderr)
    raise SystemExit(f"stopped {_TRIES} times: this machine is busy")


def share(taken: list[Turn], key: str) -> float:
    """By which a figure is larger with the devices."""
    return statistics.median(turn["with"][key] / turn["without"][key] - 1.0 for turn in taken)


def main() -> int:
    """Measure and print one JSON object; exit code 1 when a share is larger than it may be."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--turns", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fifo", type=int, help="SCHED_FIFO priority of the loop and of the emulator")
    parser.add_argument("--only", choices=tuple(MOST))
    given = parser.parse_args()
    out: dict[str, Any] = {"processors": os.cpu_count(), "load_before": os.getloadavg()[0]}
    climb(2.0, given.seed, whole=True)  # imports, and compiled code
    for name in (given.only,) if given.only else tuple(MOST):
        realtime = name == "live"
        taken = take(
            given.turns,
            lambda turn, whole, realtime=realtime: climb(
                given.seconds,
                given.seed + turn,
                whole=whole,
                realtime=realtime,
                fifo=given.fifo if realtime else None,
            ),
        )
        found = share(taken, "loop_ms" if realtime else "process_ms")
        out[name] = {"turns": taken, "share": found, "most": MOST[name], "met": found <= MOST[name]}
        if realtime:
            out[name]["process_share"] = share(taken, "process_ms")
    out["load_after"] = os.getloadavg()[0]
    print(json.dumps(out, indent=2))
    return 0 if all(out[name]["met"] for name in MOST if name in out) else 1


if __name__ == "__main__":
    raise SystemExit(main())
