"""Sensors that lie while the robot drives on its wall: who is found, how soon, and how far the robot was led.

    python benchmarks/lying_sensors.py --seeds 0:20
    python benchmarks/lying_sensors.py --only "scale 0.9,clean" --plant mujoco

Every lie begins in motion (`--at`) in every world, on lines up and across. A line of the table says in how
many runs gave a warning about the device, after how long, and how far the robot truly was from its reference
by then; how many runs were stopped; how many ended well while the estimate was wrong by more than three of
its sigmas plus 5 mm; and how many broke the promise: that, or found neither within 0.5 s nor within 15 mm of
true path error. `clean` counts false alarms. Exit code 1 where the promise is broken.
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.bench import open_bench
from hil.core.errors import HilError
from hil.core.signals import CycleRecord
from hil.robot.trajectories import line

SOON_S, NEAR_M, SIGMAS, SLACK_M = 0.5, 0.015, 3.0, 0.005
START = np.zeros(3)
WAYS = {"up": [0.4, 0.0, 0.0], "across": [0.0, 0.4, 0.0]}
LIES: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "clean": ((), ()),
    "frozen": (("tracker:stuck@{at}",), ("tracker",)),
    "standing": (("tracker:wrong@{at},scale=0",), ("tracker",)),
    "scale 0.3": (("tracker:wrong@{at},scale=0.3",), ("tracker",)),
    "scale 0.9": (("tracker:wrong@{at},scale=0.9",), ("tracker",)),
    "scale 2": (("tracker:wrong@{at},scale=2",), ("tracker",)),
    "drift up": (("tracker:wrong@{at},scale=1,drift_x_m_s=0.02",), ("tracker",)),
    "drift aside": (("tracker:wrong@{at},scale=1,drift_y_m_s=0.02",), ("tracker",)),
    "late": (("tracker:delayed@{at},delay_s=0.5",), ("tracker",)),
    "small jumps": (
        tuple(f"tracker:jump@{{at+{0.1 * k:.1f}}},distance_m=0.012" for k in range(25)),
        ("tracker",),
    ),
    "steering 0.3": (("servo.steer_FL:jump@{at},angle_rad=0.3",), ("servos", "encoders")),
    "steering 1.5": (("servo.steer_BR:jump@{at},angle_rad=1.5",), ("servos", "encoders")),
    "drive slips": (("servo.drive_FR:wrong@{at},share=0.5",), ("servos", "tracker")),
    "drives slip": (("servos:wrong@{at},share=0.5",), ("servos", "tracker")),
}
"""What is wrong, and whom one may name for it."""


@dataclass(frozen=True)
class Outcome:
    """What became of one drive.

    Attributes:
        warned_s: from the lie to the first word about the device; None without one.
        off_m: how far the robot was from its reference by then, at the worst.
        stopped: reason of the stop; empty where the drive came to its end.
        passed_wrong: it came to its end while the estimate was further off than it says.
        said: the first word.
    """

    warned_s: float | None
    off_m: float
    stopped: str
    passed_wrong: bool
    said: str

    @property
    def broken(self) -> bool:
        """Whether the promise was not kept."""
        late = self.warned_s is None or self.warned_s > SOON_S
        return self.passed_wrong or (late and self.off_m > NEAR_M)


class Watch:
    """Sees the cycles of one drive go by."""

    def __init__(self, bench: Any, at_s: float, names: Sequence[str]) -> None:
        self._bench, self._at_s, self._names = bench, at_s, names
        self.off_m, self.warned_s, self.said = 0.0, None, ""
        self.wrong = False

    def look(self, record: CycleRecord) -> None:
        """Take one cycle."""
        t_s = record.start_ns * 1e-9
        truth = self._bench.truth().pose_body_in_wall
        if self.warned_s is None and record.reference is not None and t_s >= self._at_s:
            self.off_m = max(self.off_m, math.hypot(*(truth[:2] - record.reference.pose_in_wall[:2])))
        for event in record.events:
            if self.warned_s is None and (not self._names or event.source in self._names):
                self.tell(t_s, f"{event.source}: {event.message}")
        error_m = np.abs(truth[:2] - record.state.pose_body_in_wall[:2])
        sigma_m = np.sqrt(np.diag(record.state.covariance)[:2])
        self.wrong = bool(np.any(error_m > SIGMAS * sigma_m + SLACK_M))

    def tell(self, t_s: float, what: str) -> None:
        """Somebody has said what is wrong."""
        if self.warned_s is None:
            self.warned_s, self.said = t_s - self._at_s, what


def drive(way: str, faults: Sequence[str], names: Sequence[str], seed: int, options: Any) -> Outcome:
    """One drive in one world."""
    overrides = {"emulation.plant": options.plant}
    for name in filter(None, options.without.split(",")):
        overrides[name] = None
    stop: HilError | None = None
    with open_bench(options.bench, seed=seed, faults=tuple(faults), overrides=overrides) as bench:
        watch = Watch(bench, options.at if faults else 0.0, names)
        try:
            bench.drive(line(START, WAYS[way]), start_pose=START, hold_s=0.5, on_cycle=watch.look)
        except HilError as error:
            stop = error
            watch.tell(bench.clock.now_ns() * 1e-9, str(error))
    return Outcome(
        watch.warned_s,
        watch.off_m,
        "" if stop is None else getattr(stop, "reason", type(stop).__name__),
        stop is None and watch.wrong,
        watch.said,
    )


def at(spec: str, at_s: float) -> str:
    """A spec with its start filled in."""
    head, brace, rest = spec.partition("{at")
    if not brace:
        return spec
    more, _, tail = rest.partition("}")
    return f"{head}{at_s + float(more or 0.0):g}{tail}"


def table_line(lie: str, way: str, outcomes: Sequence[Outcome], clean: bool) -> tuple[str, bool]:
    """One line of the table, and whether the promise was broken."""
    warned = [o.warned_s for o in outcomes if o.warned_s is not None]
    broken = [o for o in outcomes if (o.warned_s is not None or o.passed_wrong if clean else o.broken)]
    median = f"{statistics.median(warned):6.2f}" if warned else "     -"
    worst = 1e3 * max(o.off_m for o in outcomes)
    stops = sorted({o.stopped for o in outcomes if o.stopped})
    stopped = sum(bool(o.stopped) for o in outcomes)
    text = (
        f"{lie:13s} {way:7s} {len(warned):3d}/{len(outcomes):<3d} {median} "
        f"{max(warned, default=math.nan):6.2f} "
        f"{worst:8.1f} {stopped:5d} {sum(o.passed_wrong for o in outcomes):6d} {len(broken):6d}  "
        f"{', '.join(stops)}"
    )
    return text, bool(broken)


def main() -> None:
    """Drive, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", default="0:20", help="FIRST:END")
    parser.add_argument("--plant", default="own")
    parser.add_argument("--bench", default="emulated")
    parser.add_argument("--without", default="", help="tables of devices to leave out, by commas")
    parser.add_argument("--only", default="", help="lies by name, by commas")
    parser.add_argument("--ways", default=",".join(WAYS))
    parser.add_argument("--at", type=float, default=2.0, help="when the lie begins, s")
    parser.add_argument("--verbose", action="store_true", help="what was said in each run")
    options = parser.parse_args()
    only = [name for name in options.only.split(",") if name] or list(LIES)
    failed = False
    print("lie           way      warned  median  worst  path mm stops passed broken  reasons")
    for lie in only:
        faults, names = LIES[lie]
        specs = [at(spec, options.at) for spec in faults]
        for way in options.ways.split(","):
            outcomes = []
            for seed in range(*map(int, options.seeds.split(":"))):
                outcomes.append(drive(way, specs, names, seed, options))
                if options.verbose:
                    print(f"   {seed}: {outcomes[-1]}")
            text, broken = table_line(lie, way, outcomes, not faults)
            failed = failed or broken
            print(text, flush=True)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
