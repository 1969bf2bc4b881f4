"""Robots as delivered drive the six motions in every world: how good odometry becomes by calibration.

Three repetitions are fitted, by every forward model, and a fourth judges.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from two_worlds.bodies import FLOOR, PERIOD_NS, robot, stand, turn
from two_worlds.results import Row

from hil.calibration.calibrate import Calibration, calibrate
from hil.calibration.evaluation import position_rmse, track
from hil.calibration.problem import make_setting
from hil.core.clock import NS_PER_S, MonotonicClock
from hil.core.geometry import Array
from hil.datasets.cleaning import Log
from hil.datasets.nominal_robot import Nominal
from hil.datasets.wheel_log import Recording, build_recording
from hil.fakes.plant import SteppedBody
from hil.procedure.odometry_motions import MOTIONS, Sizes, reference
from hil.robot.kinematics import WheelGeometry, projection

WORLDS = ("creep", "holding", "own")
MODELS = ("exact", "dry-friction", "creep")
_COUNT_RAD = 2.0 * np.pi / 4096.0
_FITTED = 3


def keys(robots: int) -> Iterator[Row]:
    """All robots in all worlds."""
    for world in WORLDS:
        for seed in range(robots):
            yield {"world": world, "seed": seed}


def judge(world: str, seed: int) -> Row:
    """One robot: mean position (mm) and heading (deg) RMSE of odometry on the fresh repetition, by model."""
    plant = robot(world, seed, drawn=True, **FLOOR)
    rounds = [repetition(plant, k, np.random.default_rng([seed, k])) for k in range(1, _FITTED + 2)]
    fitted, fresh = [r for part in rounds[:_FITTED] for r in part], rounds[_FITTED]
    row: Row = {"nominal": _errors(fresh, Nominal().geometry, "exact")}
    for model in MODELS:
        setting = make_setting("recommended", model=model)
        found = calibrate(fitted, setting, MonotonicClock(), validate=False)
        row[model] = _errors(fresh, found.geometry, model)
        row[f"{model} covered"] = _covered(found, plant.parameters.geometry(), fresh)
    return row


def _errors(recordings: list[Recording], geometry: WheelGeometry, model: str) -> list[float]:
    tracks = [track(r, geometry, model) for r in recordings]
    position = [1e3 * position_rmse(t) for t in tracks]
    heading = [float(np.degrees(np.sqrt(np.mean(t.error[:, 2] ** 2)))) for t in tracks]
    return [round(float(np.mean(position)), 4), round(float(np.mean(heading)), 4)]


def _covered(found: Calibration, true: WheelGeometry, fresh: list[Recording]) -> list[int]:
    """How many of 16 parameters, and of 9 entries of the twist correction, lie in their 95 % intervals.

    What the twist correction truly is the fresh repetition says: the body's motion against that of nominal
    odometry, which no model of ours has made.
    """
    intervals = found.intervals
    wrong = np.abs(found.fit.solution.z - true.vector()[: len(found.fit.solution.z)])
    off = np.abs(found.twist - _driven_twist(fresh))
    return [
        int(np.count_nonzero(wrong <= intervals.quantile * intervals.std)),
        int(np.count_nonzero(off <= intervals.quantile * intervals.twist_std)),
    ]


def _driven_twist(recordings: list[Recording]) -> Array:
    """C (3, 3) of truth = C odometry, over displacements of half a second."""
    ours, theirs = [], []
    for r in recordings:
        run = track(r, Nominal().geometry, "exact")
        steps = slice(None, None, 50)
        for rows, poses in ((ours, run.odometry[steps]), (theirs, run.truth[steps])):
            move, middle = np.diff(poses, axis=0), 0.5 * (poses[1:, 2] + poses[:-1, 2])
            c, s = np.cos(middle), np.sin(middle)
            rows.append(
                np.column_stack(
                    [c * move[:, 0] + s * move[:, 1], c * move[:, 1] - s * move[:, 0], move[:, 2]]
                )
            )
    solved = np.linalg.lstsq(np.concatenate(ours), np.concatenate(theirs), rcond=None)[0]
    return np.asarray(solved.T, dtype=np.float64)


def repetition(plant: SteppedBody, number: int, rng: np.random.Generator) -> list[Recording]:
    """Six recordings, driven one after the other without listening to odometry."""
    return [drive(plant, motion, number, rng) for motion in MOTIONS]


def drive(plant: SteppedBody, motion: str, number: int, rng: np.random.Generator) -> Recording:
    """One motion by nominal inverse kinematics; what servos and motion capture would see of it."""
    start = plant.truth().pose_body_in_wall
    path = reference(motion, start, Sizes(), backwards=number % 2 == 0)
    cad = Nominal().geometry
    p = projection(cad.x_m, cad.y_m)
    middle = (p @ path.sample(0.5 * path.duration_s).twist_body).reshape(4, 2)
    heading = np.arctan2(middle[:, 1], middle[:, 0])
    heading = np.mod(heading + 0.5 * np.pi - 0.09, np.pi) - 0.5 * np.pi + 0.09
    ahead = np.column_stack([np.cos(heading), np.sin(heading)])
    stand(plant, heading - 0.1, 0.8)
    stand(plant, heading, 0.6 + 0.1 * number)
    begin_ns, rows = plant.t_ns, []
    cycles = round(path.duration_s * NS_PER_S / PERIOD_NS)
    for k in range(-100, cycles + 100):
        twist = path.sample((k + 0.5) * PERIOD_NS / NS_PER_S).twist_body if 0 <= k < cycles else np.zeros(3)
        turn(plant, np.sum((p @ twist).reshape(4, 2) * ahead, axis=1) / cad.radius_m, heading)
        plant.advance(begin_ns + (k + 101) * PERIOD_NS)
        position, rate, _ = plant.joints()
        rows.append(np.concatenate([position, rate[:4], plant.truth().pose_body_in_wall]))
    table = np.array(rows)
    t_s = np.arange(len(table)) * PERIOD_NS / NS_PER_S
    table[:, :8] = np.round(table[:, :8] / _COUNT_RAD) * _COUNT_RAD
    table[:, 12:] += rng.normal(0.0, 1.0, (len(table), 3)) * [1e-5, 1e-5, 4e-5]
    wheels, truth = Log(t_s, table[:, :12]), Log(t_s, table[:, 12:])
    return build_recording(f"{motion}_{number}", wheels, truth, motion=motion)
