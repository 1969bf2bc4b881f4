"""Right bench files: in how many worlds a cross-check contradicts a number that is right.

    python benchmarks/right_benches.py --benches 40

Each world has a seed of its own, every other one MuJoCo's physics, and sensors whose noise and random walks
are a third to three times what the profile has; the bench file does not say so. `hil doctor`, a short climb
and a quick `bring_up` run as in the campaign of wrong values, without a wrong value. `contradicted` names the
keys that were, with the measurement. `refused` are stages that failed or stopped for any reason: sensors that
are three times as noisy as the filter believes may do that, too.
"""

from __future__ import annotations

import argparse
import json
from typing import Any, NamedTuple

from hil.campaign import spread
from hil.fault_matrix.wrong_values.observed import without_mistake

PLANTS = ("own", "mujoco")
MOST = 3.0


class World(NamedTuple):
    """Seed, physics, and factor of the noise."""

    seed: int
    plant: str
    noise: float


def worlds(count: int, first: int = 0) -> list[World]:
    """Worlds with different seeds, both physics, and noise spread evenly by its logarithm."""
    pairs = max(1, (count - 1) // len(PLANTS))
    return [
        World(first + k, PLANTS[k % 2], MOST ** (2.0 * min(k // len(PLANTS), pairs) / pairs - 1.0))
        for k in range(count)
    ]


def seen(world: World) -> dict[str, Any]:
    """What one world contradicts, and which stages refused and why."""
    found = without_mistake("", world.plant, world.seed, world.noise)
    stages = {"doctor": found.doctor, "climb": found.climb, "bring_up": found.bring_up}
    refused = {name: told.texts for name, told in stages.items() if told.refused}
    return {**world._asdict(), "contradicted": found.contradicted, "refused": refused}


def lost(world: World, reason: str) -> dict[str, Any]:
    """Result of a world whose process died."""
    return {**world._asdict(), "contradicted": {}, "refused": {"lost": [reason]}}


def main() -> None:
    """Run and print one JSON object."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--benches", type=int, default=40, help="number of worlds [default: 40]")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--workers", type=int, default=0, help="processes; 0 runs here")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []

    def done(row: dict[str, Any]) -> None:
        rows.append(row)
        print(json.dumps(row), flush=True)

    spread(seen, worlds(given.benches, given.first), lost=lost, done=done, workers=given.workers)
    false = [row["seed"] for row in rows if row["contradicted"]]
    refused = [row["seed"] for row in rows if row["refused"]]
    print(json.dumps({"benches": len(rows), "contradicted": len(false), "refused": len(refused)}))
    raise SystemExit(bool(false))


if __name__ == "__main__":
    main()
