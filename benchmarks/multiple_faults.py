"""Random runs with several faults at once, judged by the true world: is a robot let go that could be held?

    python benchmarks/multiple_faults.py --runs 0:40 --processes 2
    python benchmarks/multiple_faults.py --runs 17:18 --plant mujoco --json

Each run is a climb of 12 cm with EKF and two to four faults of different devices, from the vocabulary that
the devices declare. The run number seeds the choice and the world. A fault begins before the drive, in
motion, in the hold check or after the close, for a time or until the end. In a third of the runs the first
fault is a wire that fails in one direction, in silence or in pieces, in another third a wrong force of fan or
propellers by a factor of 0.3 to 4. A run is red if the robot

* fell although no fault truly took away fan or propellers, or made the propellers push so wrongly that by
  statics the force that is asked of the fan cannot hold against it;
* was reported HELD with less than the true least force, or moved by more than 5 mm afterwards, unless servos
  or forces were taken away only after that report;
* was pushed by more than 100 N after the close;

or if an exception came that is not one of this project. Where the stricter judge of `hil faults` has more to
say, which is written for single faults, the run is counted as `noted`. Exit code 1 for a red run.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import statistics
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context

import numpy as np

from hil.bench import supported_faults
from hil.config.loading import load_bench
from hil.fault_matrix.cases import BEGUN_S, DURATION_S, PLANTS, Cell
from hil.fault_matrix.drive import observed
from hil.fault_matrix.judge import judge
from hil.fault_matrix.movement_bounds import FARTHEST_M, LEAST_ADHESION_N, crept_most_m, let_go
from hil.fault_matrix.observation import Seen
from hil.fault_matrix.strengths import DEFAULT, strengths_of
from hil.faults.fault import WAYS, Supported, parse_fault

FIRST_SEED = 690_000
"""Seed of the world of run 0."""
STOPS_S, CLOSES_S, ENDS_S = BEGUN_S + DURATION_S + 0.3, 9.5, 13.0
"""World times of a climb without a fault: the stop, the report, and the last start of a fault."""
MOMENTS = ((0.0, BEGUN_S), (BEGUN_S, STOPS_S), (STOPS_S, CLOSES_S), (CLOSES_S, ENDS_S))
FORCES, FACTORS = ("adhesion", "thrust"), (0.3, 4.0)
WIRES = ("silent", "pieces")
PRESS_N, PUSH_N = 45.0, 22.3
"""Forces of fan and propellers that the shipped bench asks for."""
FEWEST, MOST, LONGEST_S, MOST_THRUST_N = 2, 4, 1.5, 100.0


@dataclass(frozen=True)
class Ran:
    """What became of one run.

    Attributes:
        run, plant, faults: what was run.
        outcome: HELD, NOT HELD, `did not open`, or `fell` and what explains that.
        ended: reason of the stop, or `went on`.
        moved_mm: true motion between the stop and the report.
        crept_mm: true motion from the report on.
        red: promises of this benchmark that were broken.
        noted: what the judge of single faults says.
    """

    run: int
    plant: str
    faults: tuple[str, ...]
    outcome: str
    ended: str
    moved_mm: float
    crept_mm: float
    red: tuple[str, ...]
    noted: tuple[str, ...]

    @property
    def command(self) -> str:
        """Command that repeats the run."""
        one = f"--runs {self.run}:{self.run + 1} --plant {self.plant}"
        return f"python benchmarks/multiple_faults.py {one}"


def drawn(run: int, plant: str, supported: Mapping[str, Supported]) -> Cell:
    """Return the run with this number: the same faults on every plant."""
    rng = np.random.default_rng([FIRST_SEED, run])
    pairs = [(d, f) for d, faults in supported.items() for f in faults if not re.fullmatch(r"servo\.\d+", d)]
    wires = [(d, f) for d, f in pairs if f in WIRES or "direction" in supported[d][f]]
    first = (pairs, wires, [(d, "wrong") for d in FORCES])[int(rng.integers(3))]
    chosen: list[tuple[str, str]] = []
    wanted = int(rng.integers(FEWEST, MOST + 1))
    while len(chosen) < wanted:
        among = pairs if chosen else first
        device, fault = among[int(rng.integers(len(among)))]
        if all(_head(device) != _head(other) for other, _ in chosen):
            chosen.append((device, fault))
    specs = tuple(_spec(device, fault, supported[device][fault], rng) for device, fault in chosen)
    devices, faults = ("+".join(names) for names in zip(*chosen, strict=True))
    return Cell(devices, faults, "random", FIRST_SEED + run, plant, specs)


def _head(device: str) -> str:
    return device.split(".", 1)[0].rstrip("s")


def _is_force(device: str, fault: str) -> bool:
    return device in FORCES and fault == "wrong"


def _spec(device: str, fault: str, options: Sequence[str], rng: np.random.Generator) -> str:
    """Return one fault with a random start, duration and strength."""
    start_s = rng.uniform(*MOMENTS[int(rng.integers(len(MOMENTS)))])
    lasts = f"+{rng.uniform(0.05, LONGEST_S):.2f}" if rng.random() < 0.5 else ""
    strengths = strengths_of(device, fault, options) or (DEFAULT,)
    strength = strengths[int(rng.integers(len(strengths)))]
    if _is_force(device, fault):
        strength = f"factor={np.exp(rng.uniform(*np.log(FACTORS))):.2f}"
    elif "direction" in options and "direction" not in strength:
        strength = ",".join(filter(None, (strength, f"direction={WAYS[int(rng.integers(len(WAYS)))]}")))
    return ",".join(filter(None, (f"{device}:{fault}@{start_s:.2f}{lasts}", strength)))


def explained(cell: Cell, seen: Seen) -> str:
    """Return what took the hold of the robot away; empty if it could have been held."""
    if let_go(cell, seen.adhesion_n, seen.thrust_n):
        return "force away"
    factors = [
        parse_fault(spec).option("factor", 1.0) for spec in cell.specs if spec.startswith("thrust:wrong")
    ]
    config = load_bench("emulated")
    statics = config.robot.statics(math.radians(90.0), config.environment.known_friction)
    off = any(statics.needed_n(factor * PUSH_N, 0.0) > PRESS_N for factor in factors)
    return "pushed off" if off else ""


def broken(cell: Cell, seen: Seen) -> Iterator[str]:
    """Yield every promise of this benchmark that a run broke."""
    if seen.foreign:
        yield f"an exception of another kind: {seen.foreign}"
    if seen.fallen and not explained(cell, seen):
        yield f"fell with {seen.adhesion_n:.1f} N of the fan and {seen.thrust_n:.1f} N of the propellers"
    if not seen.most_thrust_n <= MOST_THRUST_N:
        yield f"pushed by {seen.most_thrust_n:.0f} N after the close"
    if seen.state != "HELD":
        return
    if seen.on_wall and not seen.held_adhesion_n >= LEAST_ADHESION_N:
        yield f"reported HELD with {seen.held_adhesion_n:.1f} N of {LEAST_ADHESION_N:g} N"
    late = _after(cell, seen.looked_s)
    if late is not None and explained(late, seen):
        return
    most_m = FARTHEST_M if late is None else crept_most_m(late, seen.looked_s)
    if seen.fallen or not seen.crept_m <= most_m:
        yield f"moved by {1e3 * seen.crept_m:.1f} mm after HELD{', and fell' if seen.fallen else ''}"


def _after(cell: Cell, time_s: float) -> Cell | None:
    """Return the faults that began after a time; None without one."""
    rows = zip(cell.device.split("+"), cell.fault.split("+"), cell.specs, strict=True)
    late = [row for row in rows if parse_fault(row[2]).start_ns * 1e-9 >= time_s]
    if not late:
        return None
    devices, faults, specs = zip(*late, strict=True)
    return replace(cell, device="+".join(devices), fault="+".join(faults), specs=specs)


def ran(cell: Cell) -> Ran:
    """Drive one cell and judge what was seen."""
    seen = observed(cell, compared=False)
    end = seen.stop or seen.error
    outcome = f"fell, {explained(cell, seen)}" if seen.fallen else seen.state or "did not open"
    red = tuple(broken(cell, seen))
    return Ran(
        cell.seed - FIRST_SEED,
        cell.plant,
        cell.specs,
        outcome,
        "went on" if end is None else end.reason,
        round(1e3 * seen.moved_m, 2),
        round(1e3 * seen.crept_m, 2),
        red,
        judge(cell, seen).why,
    )


def printed(runs: Sequence[Ran], plants: Sequence[str]) -> None:
    """Print the table by outcome and reason, and the motion after HELD."""
    counts = Counter((r.outcome, r.ended, r.plant) for r in runs)
    print(f"{'outcome':16s} {'ended':26s} " + " ".join(f"{plant:>7s}" for plant in plants))
    for outcome, ended in sorted({key[:2] for key in counts}):
        cells = " ".join(f"{counts[outcome, ended, plant]:7d}" for plant in plants)
        print(f"{outcome:16s} {ended:26s} {cells}")
    for plant in plants:
        mine = [r for r in runs if r.plant == plant]
        held = [r for r in mine if r.outcome == "HELD"]
        print(f"{plant}: {len(mine)} runs, {sum(bool(r.red) for r in mine)} red, ", end="")
        print(f"{sum(bool(r.noted) for r in mine)} noted, {len(held)} HELD", end="")
        for name, values in (("stop", [r.moved_mm for r in held]), ("HELD", [r.crept_mm for r in held])):
            if values:
                print(f"; after the {name} median {statistics.median(values):.2f} mm, ", end="")
                print(f"most {max(values):.2f} mm", end="")
        print()


def main() -> int:
    """Drive, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", default="0:40", help="FIRST:END")
    parser.add_argument("--plant", default=",".join(PLANTS), help="by commas")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="one object a line for each run, and no table")
    given = parser.parse_args()
    supported, plants = supported_faults(load_bench("emulated")), given.plant.split(",")
    cells = [drawn(k, plant, supported) for k in range(*map(int, given.runs.split(":"))) for plant in plants]
    runs: list[Ran] = []
    with ProcessPoolExecutor(given.processes, mp_context=get_context("spawn")) as pool:
        for one in pool.map(ran, cells):
            runs.append(one)
            if given.json:
                print(json.dumps(asdict(one)), flush=True)
            elif one.red:
                print(f"RED {one.command}\n    {' '.join(one.faults)}\n    {'; '.join(one.red)}", flush=True)
    if not given.json:
        printed(runs, plants)
    return 1 if any(one.red for one in runs) else 0


if __name__ == "__main__":
    sys.exit(main())
