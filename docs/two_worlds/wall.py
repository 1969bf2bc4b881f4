"""Lines on the melamine wall by odometry, EKF and UKF, in every world, with nothing tuned for any of them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from two_worlds.results import Row

from hil import open_bench
from hil.procedure.tracking_errors import enable_hold, tracking_errors
from hil.replay.estimator_comparison import consistency
from hil.robot.trajectories import line

WORLDS: dict[str, dict[str, object]] = {
    "creep": {"emulation.plant": "mujoco", "emulation.contact": "creep"},
    "holding": {"emulation.plant": "mujoco", "emulation.contact": "holding"},
    "own": {},
}
GOALS = {"x_line": (1.5, 0.0, 0.0), "y_line": (0.0, 1.5, 0.0)}


def keys(seeds: int) -> Iterator[Row]:
    """All drives: EKF everywhere, UKF in the other world, odometry where it is to fail."""
    for seed in range(seeds):
        for world in WORLDS:
            feedbacks = ["ekf"]
            feedbacks += ["odometry"] if world == "creep" else []
            feedbacks += ["ukf"] if world != "own" else []
            for case, feedback in itertools.product(GOALS, feedbacks):
                yield {"world": world, "case": case, "feedback": feedback, "seed": seed}


def drive(world: str, case: str, feedback: str, seed: int) -> Row:
    """One drive of 1.5 m in 30 s on a bench of its own: errors of the true pose, mm and deg, and NEES."""
    with open_bench("emulated", seed=seed, overrides=WORLDS[world]) as bench:
        start = enable_hold(bench)
        goal = line(start, start + np.array(GOALS[case]), duration_s=30.0)
        motion = bench.drive(goal, feedback=feedback, hold_s=2.0, start_pose=start)
        errors = tracking_errors(motion)
        return {
            **{k: round(v, 4) for k, v in errors.items()},
            "nees": round(consistency(motion)["nees_pose"], 4),
        }
