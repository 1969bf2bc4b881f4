"""How much faster this source tree is in virtual time than another one, turn by turn in the same minute.

    python benchmarks/virtual_pair.py --against ../before --seconds 20

Both trees run the same things in a process each, 40 control cycles in turn, so that whatever else the
machine does meets both: `rig` reads and commands all devices of the shipped bench; `five` those of them that
version 0.1 had: servos, encoders, IMU, camera, motion capture; `wall` drives a line up the wall with EKF,
supervisor and recording, by all devices of each tree; `wall_of_five` the same by those five devices. A
cycle's processor time is the 10th percentile of the turns. How much faster: `faster` is the median over the
turns, each against the other tree's turn of the same cycles; `faster_in_all` compares the sums of the turns,
with what comes now and then, as the search for garbage, and with whatever disturbed one of them.
Without `--against` only this tree is measured. `--pause 0.008` sleeps so long after every cycle, as a loop in
real time does: what the same steps take of a processor that has done something else meanwhile.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

RATE_HZ = 100
TURN_CYCLES = 40
HOLDING = ("adhesion", "thrust", "load_cells")
HERE = Path(__file__).resolve().parents[1]


class Turns:
    """Waits to be called, and ends each turn by telling its processor time; may pause after every cycle."""

    def __init__(self, pause_s: float) -> None:
        self._cycles, self._pause_s = 0, pause_s
        self._wait()

    def _wait(self) -> None:
        sys.stdin.readline()
        self._began_s = time.process_time()

    def cycle(self) -> None:
        """One control cycle is over."""
        self._cycles += 1
        if self._pause_s > 0.0:
            time.sleep(self._pause_s)
        if self._cycles % TURN_CYCLES:
            return
        print(time.process_time() - self._began_s, flush=True)
        self._wait()


def without_holding() -> dict[str, object]:
    """Overrides that leave the devices of version 0.1, in any tree."""
    import hil

    profile = Path(hil.__file__).parent / "config" / "profiles" / "emulated.toml"
    known = profile.read_text(encoding="utf-8") if profile.exists() else ""
    return {name: None for name in HOLDING if f"[{name}]" in known}


def five(seconds: float, cycle: Callable[[], None]) -> None:
    """Read and command the devices of version 0.1."""
    rig(seconds, cycle, without_holding())


def rig(seconds: float, cycle: Callable[[], None], overrides: Mapping[str, object] | None = None) -> None:
    """Read and command the devices of the shipped bench."""
    import hil
    from hil.core.signals import ServoSetpoint

    with hil.open_bench("emulated", seed=1, overrides=overrides or {}) as bench:
        devices = bench.devices if hasattr(bench, "devices") else bench.rig  # the name in an earlier tree
        actuators = devices.actuators()
        deadline_ns = bench.clock.now_ns()
        for k in range(round(seconds * RATE_HZ)):
            bench.clock.sleep_until_ns(deadline_ns)
            devices.read(k)
            t_s = k / RATE_HZ
            steer_rad = np.full(4, 0.3 * math.sin(0.5 * t_s))
            actuators.command(ServoSetpoint(np.full(4, 2.0 * math.sin(0.2 * t_s)), steer_rad))
            deadline_ns += 1_000_000_000 // RATE_HZ
            cycle()


def wall_of_five(seconds: float, cycle: Callable[[], None]) -> None:
    """Drive a line up the wall by the EKF, recorded, by the devices of version 0.1."""
    wall(seconds, cycle, without_holding())


def wall(seconds: float, cycle: Callable[[], None], overrides: Mapping[str, object] | None = None) -> None:
    """Drive a line up the wall by the EKF, recorded."""
    import hil
    from hil.recording.mcap_writer import McapRecorder
    from hil.robot.trajectories import line

    opened = hil.open_bench("emulated", seed=1, overrides=overrides or {})
    with tempfile.TemporaryDirectory() as folder, opened as bench:
        bench.add_sink(McapRecorder(Path(folder) / "wall.mcap", bench.header(), lossless=True))
        goal_m = min(0.05 * seconds, 1.0)
        bench.drive(line((0, 0, 0), (goal_m, 0, 0), duration_s=seconds), on_cycle=lambda record: cycle())


WORKS = {"rig": rig, "five": five, "wall": wall, "wall_of_five": wall_of_five}


def started(command: list[str], tree: Path) -> subprocess.Popen[str]:
    """A process of a tree, waiting for its first turn."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    return subprocess.Popen(
        command, cwd=tree, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def turn(process: subprocess.Popen[str]) -> list[float]:
    """Call for the next turn: its processor time, s; empty when all is over."""
    assert process.stdout is not None
    assert process.stdin is not None
    with suppress(BrokenPipeError):
        process.stdin.write("\n")
        process.stdin.flush()
    line = process.stdout.readline()
    return [float(line)] if line else []


def in_turns(processes: dict[str, subprocess.Popen[str]]) -> dict[str, list[float]]:
    """Processor time of each process's turns, s, until all are over."""
    taken: dict[str, list[float]] = {name: [] for name in processes}
    going = set(processes)
    while going:
        for name in sorted(going):
            found = turn(processes[name])
            taken[name] += found
            going -= set() if found else {name}
    for name, process in processes.items():
        if process.wait():
            raise SystemExit(f"{name}: {' '.join(map(str, process.args))} failed")
    return taken


def compare(trees: dict[str, Path], work: str, seconds: float, pause_s: float) -> dict[str, float]:
    """Processor time of a cycle by tree, us, and times real time."""
    command = [sys.executable, __file__, "--turns-of", work, "--seconds", str(seconds)]
    command += ["--pause", str(pause_s)]
    taken = in_turns({name: started(command, tree) for name, tree in trees.items()})
    result: dict[str, float] = {}
    for name, values in taken.items():
        us = 1e6 * float(np.percentile(values[2:], 10)) / TURN_CYCLES
        result[f"{name}_us"], result[f"{name}_times_real"] = round(us, 1), round(1e6 / RATE_HZ / us, 2)
    if len(trees) > 1:
        now, before = np.array(taken["now"][2:]), np.array(taken["before"][2:])
        result["faster"] = round(float(np.median(before / now)), 3)
        result["faster_in_all"] = round(float(before.sum() / now.sum()), 3)
    return result


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--against", type=Path, help="another source tree")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--pause", type=float, default=0.0, help="after every cycle, s")
    parser.add_argument("--only", choices=tuple(WORKS))
    parser.add_argument("--turns-of", choices=tuple(WORKS), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.turns_of:
        return WORKS[arguments.turns_of](arguments.seconds, Turns(arguments.pause).cycle)
    trees = {"now": HERE}
    if arguments.against is not None:
        trees["before"] = arguments.against.resolve()
    chosen = [arguments.only] if arguments.only else list(WORKS)
    print(
        json.dumps(
            {work: compare(trees, work, arguments.seconds, arguments.pause) for work in chosen}, indent=1
        )
    )


if __name__ == "__main__":
    main()
