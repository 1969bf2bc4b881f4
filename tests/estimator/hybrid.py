"""Hybrid harness: real servo and motion-capture logs with simulated gyro and camera.

`python tests/estimator/hybrid.py` prints the tables of docs/estimation.md; HIL_DATA names the folder of
the public recordings. Wheels and truth are real; fitted on all repetitions but the held-out one.
"""

import os
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import numpy as np
from disturbances import ALL as DISTURBANCES
from filterpy_ukf import PlainFilterpy
from simulated_sensors import (
    CameraErrors,
    InertialErrors,
    Path,
    camera,
    cycles,
    inertial,
    start_state,
    wheel_samples,
)

from hil.calibration.fitting import fit
from hil.calibration.problem import RECOMMENDED
from hil.config.estimator import EstimatorConfig
from hil.core.clock import NS_PER_S
from hil.core.geometry import wrap_array
from hil.datasets.fit_blocks import reduce_recordings
from hil.datasets.read import read_recordings
from hil.datasets.start_pose import start_of
from hil.estimator import make_estimator
from hil.estimator.nees import nees
from hil.robot.kinematics import WheelGeometry

CAMERA, INERTIAL = CameraErrors(), InertialErrors()


@dataclass(frozen=True)
class Streams:
    """One recording as sample streams; `path` is the truth."""

    name: str
    path: Path
    start: np.ndarray
    begin_ns: int
    end_ns: int
    wheels: tuple
    gyro: tuple
    tracker: tuple


def split(recordings, held_out=4):
    """Recordings to fit on and held-out ones: the repetition is the run's number within its motion."""
    seen, fitted, held = {}, [], []
    for r in recordings:
        seen[r.motion] = seen.get(r.motion, 0) + 1
        (held if seen[r.motion] == held_out else fitted).append(r)
    return fitted, held


def calibrated(recordings, model="exact"):
    setting = replace(RECOMMENDED, model=model)
    blocks = reduce_recordings(recordings, setting.block_s, setting.signal)
    return fit(blocks, setting, WheelGeometry.nominal()).geometry


def streams(recording, seed, camera_errors=CAMERA, inertial_errors=INERTIAL):
    rng = np.random.default_rng([seed, *map(ord, recording.name)])
    inside = (recording.truth_t_s >= recording.t_s[0]) & (recording.truth_t_s <= recording.t_s[-1])
    zero_s = recording.t_s[0] - 1.0
    path = Path(recording.truth_t_s[inside] - zero_s, recording.truth_pose[inside])
    first_s, last_s = path.t_s[0], path.t_s[-1]
    t_s = recording.t_s - zero_s
    used = (t_s >= first_s - 0.05) & (t_s <= last_s)
    return Streams(
        recording.name,
        path,
        start_of(recording).pose,
        round((first_s - 0.1) * NS_PER_S),
        round(last_s * NS_PER_S),
        wheel_samples(
            t_s[used],
            recording.wheel_angle_rad[used],
            recording.steering_rad[used],
            recording.wheel_rate_rad_s[used],
        ),
        inertial(path, inertial_errors, rng, on_wall=False),
        camera(path, camera_errors, rng),
    )


@dataclass(frozen=True)
class Score:
    rmse_m: float
    rmse_rad: float
    end_m: float
    nees: float
    diagnostics: dict


def run(estimator, s):
    """Errors of an estimator over one recording, at the control cycles."""
    estimator.reset(start_state(s.begin_ns, s.start, 2e-4, 5e-4))
    t_ns, poses, covariances = [], [], []
    for m in cycles(s.begin_ns + 10_000_000, s.end_ns, s.wheels, s.gyro, s.tracker):
        state = estimator.update(m)
        t_ns.append(m.t_ns)
        poses.append(state.pose_body_in_wall)
        covariances.append(state.covariance[:3, :3])
    t_s = np.array(t_ns) / NS_PER_S
    known = t_s >= s.path.t_s[0]
    error = (np.array(poses) - s.path.at(t_s))[known]
    error[:, 2] = wrap_array(error[:, 2])
    return Score(
        float(np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1)))),
        float(np.sqrt(np.mean(error[:, 2] ** 2))),
        float(np.hypot(*error[-1, :2])),
        float(np.mean(nees(error, np.array(covariances)[known]))),
        dict(state.diagnostics),
    )


def mean(scores):
    """Mean over runs: RMSE mm, heading deg, end mm, NEES."""
    return (
        1e3 * np.mean([s.rmse_m for s in scores]),
        np.rad2deg(np.mean([s.rmse_rad for s in scores])),
        1e3 * np.mean([s.end_m for s in scores]),
        np.mean([s.nees for s in scores]),
    )


def load(folder=None):
    found = data_folder() if folder is None else folder
    return read_recordings([found])


def data_folder():
    root = FilePath(__file__).parents[2]
    return FilePath(os.environ.get("HIL_DATA", root.parent / "shared" / "data")) / "4wis4wid"


SURFACE = "floor"
"""Gravity stays out: the recordings were made on a table, and only their gyro is simulated."""

HARSH = CameraErrors(scale_sigma=0.01, drift_per_sqrt_m=5e-3, yaw_drift_per_sqrt_s=1e-3)
DRY = {"model": "dry-friction"}
RECOMMENDED_CONFIG = EstimatorConfig()
VARIANTS = {
    "odometry": ("exact", EstimatorConfig(kind="odometry")),
    "odometry, dry friction": ("dry-friction", EstimatorConfig(kind="odometry", wheels=DRY)),
    "recommended, EKF": ("exact", RECOMMENDED_CONFIG),
    "recommended, UKF": ("exact", EstimatorConfig(kind="ukf")),
    "dry-friction wheels": ("dry-friction", EstimatorConfig(wheels=DRY)),
    "no camera": ("exact", EstimatorConfig(tracker={"use": "off"})),
    "no camera, dry friction": ("dry-friction", EstimatorConfig(wheels=DRY, tracker={"use": "off"})),
    "camera over 1 s baselines": ("exact", EstimatorConfig(tracker={"baseline_s": 1.0})),
    "paper preset, EKF": ("exact", EstimatorConfig(preset="paper")),
    "paper preset, UKF": ("exact", EstimatorConfig(preset="paper", kind="ukf")),
}


def table(held, geometries, camera_errors, seeds=(0, 1)):
    """Rows of the comparison: name, RMSE mm, heading deg, end mm, NEES, worst recording mm."""
    makers = {
        name: lambda g=g, c=c: make_estimator(c, geometries[g], surface=SURFACE)
        for name, (g, c) in VARIANTS.items()
    }
    makers["filterpy's own UKF"] = lambda: PlainFilterpy(geometries["exact"])
    makers["the same, alpha 1"] = lambda: PlainFilterpy(geometries["exact"], alpha=1.0)
    for name, make in makers.items():
        scores, lost = [], []
        for recording in held:
            for seed in seeds:
                estimator = make()
                scores.append(run(estimator, streams(recording, seed, camera_errors)))
                lost.append(getattr(estimator, "lost_s", None))
        if any(at is not None for at in lost):
            print(
                f"{name:26} covariance lost in {sum(at is not None for at in lost)} of {len(lost)} runs, "
                f"the first time after {min(at for at in lost if at is not None):.2f} s"
            )
            continue
        worst = 1e3 * max(s.rmse_m for s in scores)
        print("{:26} {:7.2f} {:7.3f} {:7.2f} {:7.2f} {:7.1f}".format(name, *mean(scores), worst), flush=True)


def main():
    fitted, held = split(load())
    geometries = {model: calibrated(fitted, model) for model in ("exact", "dry-friction")}
    for title, camera_errors in (("camera as in simulated_sensors.py", CAMERA), ("harsh camera", HARSH)):
        print(f"{title}\n{'':26} RMSE mm     deg  end mm    NEES   worst")
        table(held, geometries, camera_errors)
    print("disturbances, recommended EKF: growth of the end error, mm (mean over the recordings, worst)")
    undisturbed = {r.name: run(recommended(geometries), streams(r, 0)) for r in held}
    for name, disturb in DISTURBANCES.items():
        grown = [
            1e3 * (run(recommended(geometries), disturb(streams(r, 0))).end_m - undisturbed[r.name].end_m)
            for r in held
        ]
        print(f"{name:26} {np.mean(grown):7.2f} {max(grown):7.2f}", flush=True)


def recommended(geometries):
    return make_estimator(RECOMMENDED_CONFIG, geometries["exact"], surface=SURFACE)


if __name__ == "__main__":
    main()
