"""How often the choice of the forward model is right, and what it costs where it is not.

Usage: python benchmarks/model_choice.py 100:110

For each seed one robot of each contact law (viscous, dry friction, creep with tyre ratio 1 and 0.4; loads
15 % off) is calibrated on 2 to 4 repetitions of 4 to 6 motions, a quarter of them with bursts of slip. Errors
are of motions that were not recorded, driven without chance, at the wheels, and compared with those of a fit
by the true law. The seeds 0 to 7 gave the probabilities that `hil.calibration.model_choice` starts from.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.calibration.evaluation import position_rmse, track_all
from hil.calibration.fitting import fit
from hil.calibration.model_choice import Candidate, candidates, choose
from hil.calibration.problem import RECOMMENDED
from hil.calibration.synthetic import MOTIONS, OTHER_MOTIONS, hidden_robot, make_set
from hil.datasets.fit_blocks import reduce_recordings
from hil.datasets.nominal_robot import Nominal, lever_m
from hil.datasets.wheel_log import Recording

LAWS = {
    "exact": ("viscous", 1.0),
    "dry friction": ("coulomb", 1.0),
    "creep, equal loads, tyre ratio 1": ("creep", 1.0),
    "creep, equal loads, tyre ratio 0.4": ("creep", 0.4),
}
SAID = (0.0, 0.5, 0.7, 0.9, 1.01)


def error_m(data: Sequence[Recording], unseen: Sequence[Recording], model: Candidate) -> float:
    """Mean error at the wheels of a candidate's fit, on motions that were not recorded, m."""
    setting = model.setting
    blocks = reduce_recordings(data, setting.block_s, setting.signal)
    geometry = fit(blocks, setting, model.nominal).geometry
    runs = track_all(unseen, geometry, setting.model, setting.signal)
    lever = lever_m(geometry)
    return float(
        np.mean([np.hypot(position_rmse(r), lever * np.sqrt(np.mean(r.error[:, 2] ** 2))) for r in runs])
    )


def one_set(law: str, seed: int) -> tuple[float, bool, float]:
    """Stated probability, whether the law is right, and the error over that of the true law."""
    contact, ratio = LAWS[law]
    rng = np.random.default_rng([seed, 99])
    robot = replace(hidden_robot(seed, contact=contact), ratio=ratio)
    repetitions, count = int(rng.integers(2, 5)), int(rng.integers(4, 7))
    motions = [MOTIONS[i] for i in sorted(rng.permutation(6)[:count])]
    others = [m for m in (*MOTIONS, *OTHER_MOTIONS) if m not in motions]
    data = make_set(robot, seed, motions, repetitions)
    unseen = make_set(robot, seed + 5000, others, 1, run_to_run=0.0, slip_share=0.0)
    among = candidates(RECOMMENDED, Nominal().geometry)
    choice = choose(data, among)
    true = next(one for one in among if one.name == law)
    right = choice.best.setting.model == true.setting.model
    cost = error_m(data, unseen, choice.best) / error_m(data, unseen, true)
    print(f"{law:36} {seed:4} {choice.best.name:36} {choice.confidence:5.2f} {cost:6.2f}", flush=True)
    return choice.confidence, right, cost


def main() -> None:
    """Print one line for each set, and the summary."""
    begin, end = map(int, sys.argv[1].split(":"))
    found = np.array([one_set(law, seed) for seed in range(begin, end) for law in LAWS], dtype=np.float64)
    said, right, cost = found.T
    for low, high in itertools.pairwise(SAID):
        inside = (said >= low) & (said < high)
        if inside.any():
            print(
                f"said {low:.1f} to {min(high, 1.0):.1f}: {inside.sum()} sets, "
                f"{said[inside].mean():.2f} in the mean, right {right[inside].mean():.2f}"
            )
    print(f"error over that of the true law: median {np.median(cost):.2f}, mean {cost.mean():.2f}")


if __name__ == "__main__":
    main()
