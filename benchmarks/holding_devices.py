"""What fan, propellers and load cells cost the bench.

    python benchmarks/holding_devices.py                       # 4 turns of 8 s
    python benchmarks/holding_devices.py --turns 8 --seconds 20 --only virtual

`virtual` is processor time of a climb with EKF and supervisor in virtual time, with and without the three
devices, their chips and physics included. The two climbs of a turn follow each other, so that whatever else
the machine does meets both; the share is the median over the turns. `live` is the loop's own thread in real
time, with the emulated robot in a process of its own: processor time that it spends on reading the three
devices and on judging what they say, over what it spends on everything else, of the same cycles. `--fifo 20`
lets loop and emulator go before everything else (root).
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from functools import partial
from typing import Any
from unittest.mock import patch

import hil
from hil.bench import Bench
from hil.core.errors import HilError
from hil.loop.checks.adhesion import AdhesionWatch
from hil.robot.trajectories import line

DEVICES = ("adhesion", "thrust", "load_cells")
MOST = {"virtual": 0.15, "live": 0.05}
_CLIMB_M_S = 0.02
_TRIES = 5


def climb(bench: Bench, seconds: float) -> int:
    """Drive up the wall; number of cycles."""
    pose = bench.settle()
    there = (pose[0] + _CLIMB_M_S * seconds, pose[1], pose[2])
    motion = bench.drive(line(pose, there, duration_s=seconds), start_pose=pose, hold_s=0.0)
    return len(motion.records)


def virtual(seconds: float, seed: int, whole: bool) -> float:
    """Processor time of a cycle in virtual time, ms, with or without the three devices."""
    overrides: dict[str, Any] = {} if whole else dict.fromkeys(DEVICES)
    with hil.open_bench("emulated", seed=seed, overrides=overrides) as bench:
        began_s = time.process_time()
        cycles = climb(bench, seconds)
        return 1e3 * (time.process_time() - began_s) / cycles


class Stopwatch:
    """Processor time of this thread within the functions that it is put around, by name, s."""

    def __init__(self) -> None:
        self.taken_s: dict[str, float] = {}

    def around(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, timed."""

        def timed(*given: Any, **named: Any) -> Any:
            began_s = time.thread_time()
            try:
                return function(*given, **named)
            finally:
                self.taken_s[name] = self.taken_s.get(name, 0.0) + time.thread_time() - began_s

        return timed


@contextmanager
def watched(bench: Bench) -> Any:
    """A stopwatch around reading and judging the three devices."""
    watch = Stopwatch()
    for name in DEVICES:
        device: Any = bench.devices.get(name)
        device.read = watch.around(name, device.read)
    with patch.object(AdhesionWatch, "judge", watch.around("judging", AdhesionWatch.judge)):
        yield watch


def live(seconds: float, seed: int, fifo: int | None) -> dict[str, float]:
    """Processor time of a cycle of the loop in real time, us: of the parts, and of all the rest."""
    overrides: dict[str, Any] = {"loop.fifo_priority": fifo} if fifo else {}
    with hil.open_bench("emulated", seed=seed, realtime=True, overrides=overrides) as bench:
        bench.settle()
        with watched(bench) as watch:
            began_s = time.thread_time()
            cycles = climb(bench, seconds)
            all_s = time.thread_time() - began_s
    parts_us = {name: 1e6 * taken_s / cycles for name, taken_s in watch.taken_s.items()}
    return {**parts_us, "rest": 1e6 * all_s / cycles - sum(parts_us.values())}


def again(one: Callable[[], Any]) -> Any:
    """One drive; where a machine that is busy elsewhere has stopped the robot, another."""
    for _ in range(_TRIES):
        try:
            return one()
        except HilError as error:
            print(error, file=sys.stderr)
    raise SystemExit(f"stopped {_TRIES} times: this machine is busy")


def measure_virtual(turns: int, seconds: float, seed: int) -> dict[str, Any]:
    """Both climbs of each turn, first one and then the other."""
    virtual(2.0, seed, True)  # imports, and compiled code
    taken = []
    for turn in range(turns):
        order = (True, False) if turn % 2 else (False, True)
        taken.append({whole: virtual(seconds, seed + turn, whole) for whole in order})
    found = {"with_ms": [t[True] for t in taken], "without_ms": [t[False] for t in taken]}
    return {**found, "share": statistics.median(t[True] / t[False] - 1.0 for t in taken)}


def measure_live(turns: int, seconds: float, seed: int, fifo: int | None) -> dict[str, Any]:
    """A drive a turn."""
    taken = [again(partial(live, seconds, seed + turn, fifo)) for turn in range(turns)]
    shares = [(sum(t.values()) - t["rest"]) / t["rest"] for t in taken]
    return {"cycle_us": taken, "share": statistics.median(shares)}


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
    if given.only in (None, "virtual"):
        out["virtual"] = measure_virtual(given.turns, given.seconds, given.seed)
    if given.only in (None, "live"):
        out["live"] = measure_live(given.turns, given.seconds, given.seed, given.fifo)
    for name, most in MOST.items():
        if name in out:
            out[name] |= {"most": most, "met": out[name]["share"] <= most}
    out["load_after"] = os.getloadavg()[0]
    print(json.dumps(out, indent=2))
    return 0 if all(out[name]["met"] for name in MOST if name in out) else 1


if __name__ == "__main__":
    raise SystemExit(main())
