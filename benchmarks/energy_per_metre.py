"""Energy that the fan takes per metre climbed, with a constant force and with the force that is needed."""

from __future__ import annotations

import math
from collections.abc import Iterator

import hil
from hil.robot.trajectories import line

LENGTH_M, DURATION_S, SEEDS = 1.0, 25.0, (1, 2)


def joules(by_need: bool, seed: int) -> tuple[float, float]:
    """Energy from the battery while it climbs, J, and the least margin, N."""
    energy_j, margin_n, last_ns = 0.0, math.inf, 0
    overrides = {"adhesion.by_need": by_need}
    with hil.open_bench("emulated", seed=seed, overrides=overrides) as bench:
        motion = bench.drive(line((0, 0, 0), (LENGTH_M, 0, 0), duration_s=DURATION_S), hold_s=0.0)
    for record in motion.records:
        for sample in record.inputs.adhesion:
            if last_ns and math.isfinite(sample.input_a) and math.isfinite(sample.input_v):
                energy_j += sample.input_a * sample.input_v * (sample.stamp.t_ns - last_ns) / 1e9
            last_ns = sample.stamp.t_ns
        margin_n = min(margin_n, record.state.diagnostics.get("adhesion_margin_n", math.inf))
    return energy_j, margin_n


def rows() -> Iterator[str]:
    """The lines of the table."""
    yield "| force | J per metre climbed | least margin (N) |"
    yield "|---|---|---|"
    for name, by_need in (("constant", False), ("by need", True)):
        climbs = [joules(by_need, seed) for seed in SEEDS]
        energy = sum(climb[0] for climb in climbs) / len(climbs) / LENGTH_M
        yield f"| {name} | {energy:.0f} | {min(climb[1] for climb in climbs):.1f} |"


def main() -> None:
    """Print the table."""
    for row in rows():
        print(row, flush=True)


if __name__ == "__main__":
    main()
