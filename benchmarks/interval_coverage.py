"""Do 95 % intervals of a calibration hold the truth? On data that no forward model of ours made.

`python benchmarks/interval_coverage.py 0:10` calibrates robots of these seeds as `hil calibrate` does, the
forward model by held-out recordings, and counts how often the truth lies inside: for the combinations of
parameters that the data determine, and for each parameter. Generators: formulas with viscous, dry or elastic
contact, and the emulated benches `own`, `mujoco` (tyres that creep) and `holding` (MuJoCo, dry). It ends with
1 where a generator's combinations are not between 0.88 and 0.99.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hil.bench import hidden_truth, open_bench
from hil.bench.loop_settings import nominal_of
from hil.calibration.calibrate import Calibration, calibrate
from hil.calibration.identifiability import data_information
from hil.calibration.model_choice import candidates, choose
from hil.calibration.problem import RECOMMENDED
from hil.calibration.synthetic import hidden_robot, make_set
from hil.config.loading import load_bench
from hil.core.clock import MonotonicClock
from hil.core.geometry import Array
from hil.datasets.nominal_robot import Nominal
from hil.datasets.plain_csv import read_plain
from hil.datasets.wheel_log import Recording
from hil.procedure.odometry_motions import MOTIONS, Repetition, Sizes, drive_repetition, unused

LOW, HIGH, REPETITIONS = 0.88, 0.99, 3
BENCHES = {
    "own": {"emulation.plant": "own"},
    "mujoco": {"emulation.plant": "mujoco", "emulation.contact": "creep"},
    "holding": {"emulation.plant": "mujoco", "emulation.contact": "holding"},
}
FORMULAS = ("viscous", "coulomb", "elastic")


def recorded(generator: str, seed: int, folder: Path) -> tuple[list[Recording], Array]:
    """Recordings of one robot, and its true parameters (16,)."""
    if generator in FORMULAS:
        robot = hidden_robot(seed, contact=generator)
        return make_set(robot, seed, repetitions=REPETITIONS), robot.geometry.vector()
    config = load_bench("emulated_floor", emulate="all", overrides={**unused(), **BENCHES[generator]})
    found, truth = [], np.zeros(16)
    for number in range(1, REPETITIONS + 1):
        with open_bench(config, seed=seed) as bench:
            names = drive_repetition(bench, Repetition(folder, MOTIONS, number, Sizes(1.0, 0.4, 0.5)))
            assert bench.world is not None
            hidden = hidden_truth(bench.world)
        found += [read_plain(folder / name) for name in names]
    truth = np.concatenate([np.array(hidden[key]) for key in ("x_w_m", "y_w_m", "r_m", "delta0_rad")])
    return found, truth


def inside(result: Calibration, truth: Array) -> tuple[Array, Array]:
    """Whether the interval holds the truth: of determined combinations, and of the parameters (16,)."""
    problem, z = result.fit.problem, result.fit.solution.z
    covariance, quantile = result.intervals.covariance, result.intervals.quantile
    spread = problem.prior_std
    values, vectors = np.linalg.eigh(spread[:, None] * data_information(problem, z) * spread)
    ways = vectors[:, values > 1.0] / spread[:, None]
    half = quantile * np.sqrt(np.einsum("ak,ab,bk->k", ways, covariance, ways))
    return np.abs(ways.T @ (z - truth)) <= half, np.abs(z - truth) <= quantile * result.intervals.std


def calibrated(recordings: Sequence[Recording], robot: Nominal, seed: int) -> Calibration:
    """As `hil calibrate` does it, but for the cross-validations that only its table needs."""
    choice = choose(recordings, candidates(RECOMMENDED, robot.geometry))
    paper = replace(robot, geometry=choice.best.nominal)
    return calibrate(
        recordings,
        choice.best.setting,
        MonotonicClock(),
        seed=seed,
        nominal=paper,
        choice=choice,
        validate=False,
    )


def covered(generator: str, seeds: Sequence[int]) -> float:
    """Print and return the coverage of one generator."""
    combinations, parameters, chosen = [], [], []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as scratch:
            recordings, truth = recorded(generator, seed, Path(scratch))
        robot = Nominal() if generator in FORMULAS else nominal_of(load_bench("emulated_floor"))
        result = calibrated(recordings, robot, seed)
        held, each = inside(result, truth)
        combinations += held.tolist()
        parameters.append(each)
        chosen.append(result.setting.model)
    share, each = float(np.mean(combinations)), np.mean(parameters, axis=0).reshape(4, 4).mean(axis=1)
    models = ", ".join(f"{m} {chosen.count(m)}" for m in dict.fromkeys(chosen))
    print(
        f"{generator:9}{share:6.3f} of {len(combinations)} combinations; x, y, r, zeros: "
        f"{', '.join(f'{v:.2f}' for v in each)}; forward model: {models}",
        flush=True,
    )
    return share


def main() -> int:
    """Every generator that was asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seeds", help="FIRST:BEYOND")
    parser.add_argument("--generator", action="append", choices=(*FORMULAS, *BENCHES))
    given = parser.parse_args()
    first, beyond = map(int, given.seeds.split(":"))
    shares = [covered(g, range(first, beyond)) for g in given.generator or (*FORMULAS, *BENCHES)]
    return 0 if all(LOW <= share <= HIGH for share in shares) else 1


if __name__ == "__main__":
    sys.exit(main())
