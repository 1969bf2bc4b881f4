"""How fast the whole rig runs on MuJoCo against the own plant, in the same run.

    python benchmarks/second_physics.py --turns 25

Benches of both take turns, 40 cycles of a climb at 100 Hz each, all devices emulated and read. Compared is
the 10th percentile of the turns' processor time. Ends with 1 when a ratio is below the 0.6 that is wanted.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from contextlib import ExitStack

import numpy as np

import hil
from hil.bench import Bench
from hil.core.clock import NS_PER_S
from hil.core.signals import ServoSetpoint

CYCLES, PERIOD_NS, WANTED = 40, NS_PER_S // 100, 0.6
PLANTS = {
    "own": {},
    "mujoco, creep": {"emulation.plant": "mujoco", "emulation.contact": "creep"},
    "mujoco, holding": {"emulation.plant": "mujoco", "emulation.contact": "holding"},
}


def turn_s(bench: Bench, first: int) -> float:
    """Processor time of some cycles: read everything, command the wheels."""
    actuators, clock = bench.devices.actuators(), bench.clock
    deadline_ns, begin_s = clock.now_ns(), time.process_time()
    for cycle in range(first, first + CYCLES):
        clock.sleep_until_ns(deadline_ns)
        bench.devices.read(cycle)
        steer_rad = np.full(4, 0.1 * math.sin(0.005 * cycle))
        actuators.command(ServoSetpoint(np.full(4, 2.0 * math.sin(0.002 * cycle)), steer_rad))
        deadline_ns += PERIOD_NS
    return time.process_time() - begin_s


def main() -> int:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--turns", type=int, default=25)
    given = parser.parse_args()
    spent: dict[str, list[float]] = {name: [] for name in PLANTS}
    with ExitStack() as stack:
        benches = {
            name: stack.enter_context(hil.open_bench("emulated", seed=1, overrides=overrides))
            for name, overrides in PLANTS.items()
        }
        for bench in benches.values():
            bench.devices.actuators().enable()
        for number in range(given.turns):
            for name, bench in benches.items():
                spent[name].append(turn_s(bench, number * CYCLES))
    cost_s = {name: float(np.percentile(times, 10)) for name, times in spent.items()}
    ratios = {name: cost_s["own"] / s for name, s in cost_s.items() if name != "own"}
    real_time = {name: CYCLES * PERIOD_NS / NS_PER_S / s for name, s in cost_s.items()}
    print(json.dumps({"times_real_time": real_time, "of_the_own_plant": ratios, "wanted": WANTED}, indent=1))
    return 0 if min(ratios.values()) >= WANTED else 1


if __name__ == "__main__":
    raise SystemExit(main())
