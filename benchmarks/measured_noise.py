"""Is the filter as sure as it may be on robots whose sensors nobody has told it about?

    python benchmarks/measured_noise.py 11 12 13

Each emulated robot has sensors of another size of noise than the profile's: every combination below, one
after the other through the seeds. `sensor_noise` measures them and keeps them in a record; then the robot
drives an X line and a Y line on its wall with the record, and with `--without` also by the defaults. A row is
one line: NIS per row by sensor, NEES of the pose against the emulated robot's own truth, heading in deg. The
last lines are means.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from pathlib import Path

import numpy as np

from hil.bench import open_bench
from hil.config.loading import load_bench
from hil.core.clock import MonotonicClock
from hil.core.geometry import wrap_array
from hil.estimator.nees import nees
from hil.loop.driven_motion import Motion
from hil.procedure.bench_source import BenchSource
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.runner import RunOptions, run_procedure
from hil.procedure.tracking_errors import enable_hold
from hil.robot.trajectories import line

THIRD = 1.0 / 3.0
COMBINATIONS = (
    (1.0, 1.0, 1.0, 1.0),
    (3.0, 3.0, 3.0, 3.0),
    (THIRD, THIRD, THIRD, THIRD),
    (1.0, 3.0, THIRD, 1.0),
    (3.0, THIRD, 1.0, 3.0),
    (THIRD, 1.0, 3.0, 1.0),
)
"""Factors on the noise of wheels, gyro, camera and motion capture."""
CAMERA = {
    "position_walk_m_sqrt_m": 0.001,
    "position_noise_m": 3e-4,
    "angle_noise_rad": 5e-4,
    "yaw_walk_rad_sqrt_s": 2e-4,
    "yaw_rate_sigma_rad_s": 5e-5,
}
SENSORS = {"wheels": 8, "gyro": 1, "tracker": 3}
COUNT_VARIANCE, DITHER = 1.0 / 12.0, 0.25
"""Of rounding to counts, which nothing makes smaller, and the dither before it."""


def robot(wheels: float, gyro: float, camera: float, mocap: float) -> dict[str, object]:
    """Overrides of the bench for a robot whose sensors are so many times as noisy."""
    own = load_bench("emulated_delivered").emulation.tracker
    dither = max(wheels**2 * (COUNT_VARIANCE + DITHER**2) - COUNT_VARIANCE, 0.0) ** 0.5
    return {
        "emulation.geometry_share": 0.2,
        "emulation.tracker": {
            **{k: v for k, v in own.items() if not k.startswith("mount_")},
            **{key: camera * value for key, value in CAMERA.items()},
        },
        "emulation.imu": {"gyro_noise_rad_s": 0.0017 * gyro, "accelerometer_noise_m_s2": 0.02 * gyro},
        "emulation.servos.dither_counts": dither,
        "emulation.mocap": {"position_noise_m": 1e-5 * mocap, "angle_noise_rad": 4e-5 * mocap},
    }


def figures(motion: Motion, rows: dict[str, int]) -> list[float]:
    """NIS of the sensors, NEES and heading of one line."""
    nis = []
    for name, count in rows.items():
        nis.append(float(np.nanmean(motion.diagnostic(f"nis_{name}"))) / count)
    truth = np.array([r.truth["pose_body_in_wall"] for r in motion.records if r.truth is not None])
    error = motion.estimate - truth
    error[:, 2] = wrap_array(error[:, 2])
    sure = float(np.nanmean(nees(error, motion.covariance[:, :3, :3])[50:]))
    return [*nis, sure, float(np.degrees(np.sqrt(np.mean(error[:, 2] ** 2))))]


def lines(seed: int, overrides: dict[str, object], way_m: float) -> list[list[float]]:
    """Figures of the X line and of the Y line."""
    found = []
    for direction in ((way_m, 0.0, 0.0), (0.0, way_m, 0.0)):
        with open_bench("emulated_delivered", seed=seed, overrides=overrides) as bench:
            start = enable_hold(bench)
            reference = line(start, start + np.array(direction), duration_s=20.0 * way_m)
            motion = bench.drive(reference, feedback="ekf", hold_s=1.0, start_pose=start)
            model = bench.config.estimator.wheels.model
            found.append(figures(motion, SENSORS | ({} if model == "equations" else {"wheels": 3})))
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seeds", type=int, nargs="+")
    parser.add_argument("--plant", choices=("own", "mujoco"), default="own")
    parser.add_argument("--way", type=float, default=1.0, help="length of a line, m")
    parser.add_argument("--without", action="store_true", help="also with the defaults")
    asked = parser.parse_args()
    proc, every = load_procedure("sensor_noise"), {"measured": [], "defaults": []}
    print("wheels gyro camera mocap | seed line noise | NIS wheels  gyro  camera | NEES  heading deg")
    for seed, factors in zip(asked.seeds, itertools.cycle(COMBINATIONS), strict=False):
        overrides = {**robot(*factors), "emulation.plant": asked.plant}
        with tempfile.TemporaryDirectory() as folder:
            kept = {**overrides, "record.folder": str(Path(folder) / "robot")}
            source = BenchSource("emulated_delivered", seed=seed, overrides=kept)
            result = run_procedure(
                proc, source, RunOptions(Path(folder) / "run", MonotonicClock(), "2026-01-01", {})
            )
            print(f"sensor_noise with seed {seed}: {result.verdict.value}", flush=True)
            sets = {"measured": kept} | ({"defaults": overrides} if asked.without else {})
            for name, used in sets.items():
                for case, row in zip("xy", lines(seed, used, asked.way), strict=True):
                    every[name].append(row)
                    shown = "  ".join(f"{v:6.3f}" for v in row)
                    print(*(f"{f:5.2f}" for f in factors), f"| {seed:4} {case} {name} | {shown}", flush=True)
    for name, rows in every.items():
        if rows:
            print(f"mean, {name}: " + "  ".join(f"{v:.3f}" for v in np.mean(rows, axis=0)))


if __name__ == "__main__":
    main()
