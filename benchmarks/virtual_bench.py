"""How much faster than real time the whole emulated rig is read and commanded, and whether it repeats itself.

    python benchmarks/virtual_bench.py --seconds 20 --runs 3

Eight servos, encoders, IMU, tracker and motion capture are read and the servos commanded at 100 Hz in
virtual time, without estimator and controller: what drivers, wires, chips and the robot's physics cost.
`ratio` counts processor time of this process, so that other work on the machine matters little;
`log_sha256` covers every sample of every device, and must be the same for every run with one seed.
"""

from __future__ import annotations

import argparse
import dataclasses
import enum
import hashlib
import json
import math
import statistics
import time
from collections.abc import Iterator

import numpy as np

import hil
from hil.core.clock import NS_PER_S
from hil.core.signals import Inputs, ServoSetpoint

RATE_HZ = 100
PERIOD_NS = NS_PER_S // RATE_HZ
TARGET = 10.0


def run(bench_name: str, seed: int, seconds: float) -> tuple[list[Inputs], float, float]:
    """One run: everything that was read, processor time and wall time in seconds."""
    log: list[Inputs] = []
    with hil.open_bench(bench_name, seed=seed) as bench:
        rig, clock = bench.devices, bench.clock
        actuators = rig.actuators()
        actuators.enable()
        began_s, began_cpu_s = time.perf_counter(), time.process_time()
        deadline_ns = clock.now_ns()
        for cycle in range(round(seconds * RATE_HZ)):
            clock.sleep_until_ns(deadline_ns)
            log.append(rig.read(cycle))
            t_s = cycle / RATE_HZ
            steer_rad = np.full(4, 0.3 * math.sin(0.5 * t_s))
            actuators.command(ServoSetpoint(np.full(4, 2.0 * math.sin(0.2 * t_s)), steer_rad))
            deadline_ns += PERIOD_NS
        return log, time.process_time() - began_cpu_s, time.perf_counter() - began_s


def digest(log: list[Inputs]) -> str:
    """Fingerprint of every number that the devices delivered."""
    total = hashlib.sha256()
    for inputs in log:
        for piece in _pieces(inputs):
            total.update(piece)
    return total.hexdigest()


def _pieces(value: object) -> Iterator[bytes]:
    if isinstance(value, np.ndarray):
        yield value.tobytes()
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from _pieces(getattr(value, field.name))
    elif isinstance(value, tuple):
        yield len(value).to_bytes(2, "little")
        for item in value:
            yield from _pieces(item)
    else:
        yield repr(value.value if isinstance(value, enum.Enum) else value).encode()


def main() -> None:
    """Measure and print one JSON object; exit code 1 when runs with one seed differ."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bench", default="emulated")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    run(arguments.bench, arguments.seed, 0.5)
    ratios, wall_ratios, hashes = [], [], set()
    for _ in range(arguments.runs):
        log, cpu_s, wall_s = run(arguments.bench, arguments.seed, arguments.seconds)
        ratios.append(arguments.seconds / cpu_s)
        wall_ratios.append(arguments.seconds / wall_s)
        hashes.add(digest(log))
    other = digest(run(arguments.bench, arguments.seed + 1, min(1.0, arguments.seconds))[0])
    print(
        json.dumps(
            {
                "virtual_seconds": arguments.seconds,
                "ratio": round(statistics.median(ratios), 2),
                "ratio_best": round(max(ratios), 2),
                "ratio_wall": round(statistics.median(wall_ratios), 2),
                "target": TARGET,
                "repeats": len(hashes) == 1,
                "log_sha256": sorted(hashes),
                "other_seed_differs": other not in hashes,
            },
            indent=1,
        )
    )
    raise SystemExit(len(hashes) != 1)


if __name__ == "__main__":
    main()
