"""Hybrid harness: real servo and motion-capture logs with simulated gyro and camera.

`python tests/estimator/hybrid.py` prints the tables of docs/estimation.md.
"""

from dataclasses import dataclass, replace

import numpy as np

from hil.calibration.blocks import reduce_recordings
from hil.calibration.evaluation import rest_pose
from hil.calibration.fitting import fit
from hil.calibration.problem import RECOMMENDED
from hil.clock import NS_PER_S
from hil.estimator.simulated_sensors import (
    CameraErrors,
    InertialErrors,
    Path,
    camera,
    cycles,
    inertial,
    start_state,
    wheel_samples,
)
from hil.geometry import wrap_array
from hil.kinematics import WheelGeometry
from hil.recording.sources import read_recordings

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
        rest_pose(recording),
        round((first_s - 0.1) * NS_PER_S),
        round(last_s * NS_PER_S),
        wheel_samples(
            t_s[used], recording.wheel_angle_rad[used], recording.steering_rad[used],
            recording.wheel_rate_rad_s[used],
        ),
        inertial(path, inertial_errors, rng, on_wall=False),
        camera(path, camera_errors, rng),
    )  # fmt: skip


@dataclass(frozen=True)
class Score:
    rmse_m: float
    rmse_rad: float
    end_m: float
    nees: float
    diagnostics: dict


def run(estimator, s, *, estimate_only=False):
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
    if estimate_only:
        return error
    solved = np.linalg.solve(np.array(covariances)[known] + 1e-14 * np.eye(3), error[..., None])[..., 0]
    return Score(
        float(np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1)))),
        float(np.sqrt(np.mean(error[:, 2] ** 2))),
        float(np.hypot(*error[-1, :2])),
        float(np.mean(np.sum(error * solved, axis=1))),
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


def load(folder):
    return read_recordings([folder])
