"""A short simulated drive with everything that happens: turns, latency, outliers, a lost wheel."""

import functools
from dataclasses import dataclass, replace

import numpy as np
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

from hil.core.clock import NS_PER_S
from hil.core.geometry import compose, se2_exp
from hil.core.signals import PoseMeasurement, RobotState, Stamp
from hil.robot.kinematics import WheelGeometry


@dataclass(frozen=True)
class Drive:
    start: RobotState
    measurements: tuple
    path: Path


def twist(t_s):
    """A gentle slalom in every direction of motion."""
    return np.array([0.05 + 0.02 * np.sin(t_s), 0.03 * np.sin(1.3 * t_s), 0.25 * np.sin(0.7 * t_s)])


@functools.cache
def true_path(seconds, rate_hz=1000.0, start_s=1.0, motion=twist):
    t_s = start_s + np.arange(int(seconds * rate_hz) + 1) / rate_hz
    poses = [np.zeros(3)]
    for t in t_s[:-1]:
        poses.append(compose(poses[-1], se2_exp(motion(t - start_s + 0.5 / rate_hz) / rate_hz)))
    return Path(t_s, np.array(poses))


def wheel_log(path, rate_hz, rng, motion=twist, noise_m=2e-5):
    """Wheel angle, steering, rate at `rate_hz`: displacements along the path, with white noise."""
    geometry = WheelGeometry.nominal()
    fine = path.t_s - path.t_s[0]
    p = geometry.projection()
    u = np.array([p @ motion(t) for t in fine]).reshape(-1, 4, 2)
    steering = np.arctan2(u[..., 1], u[..., 0])
    speed = np.hypot(u[..., 0], u[..., 1])
    dt = np.diff(path.t_s, prepend=path.t_s[0])[:, None]
    angle = np.cumsum(speed * dt, axis=0) / geometry.radius_m
    keep = np.arange(0, len(fine), round(1000.0 / rate_hz))
    angle = angle[keep] + noise_m / 0.0254 * rng.normal(size=(len(keep), 4))
    return path.t_s[keep], angle, steering[keep], speed[keep] / geometry.radius_m


def with_outliers(wheels, tracker, rng):
    """One wheel slips for a while, one is lost for a while, the camera shows nonsense now and then."""
    bad = []
    for k, w in enumerate(wheels):
        angle, valid = w.wheel_angle_rad.copy(), list(w.valid)
        if k > 30:
            angle[1] += 0.02 * min(k - 30, 20)
        if 60 < k < 80:
            valid[2] = False
        bad.append(replace(w, wheel_angle_rad=angle, valid=tuple(valid)))
    poses = [
        replace(t, pose=t.pose + 0.015 * rng.normal(size=3)) if k % 41 == 40 else t
        for k, t in enumerate(tracker)
    ]
    return tuple(bad), tuple(poses)


@functools.cache
def drive(seconds=2.0, seed=0, outliers=False, camera_rate_hz=100.0, wheel_noise_m=2e-5):
    """A drive as control cycles."""
    rng = np.random.default_rng(seed)
    path = true_path(seconds)
    wheels = wheel_samples(*wheel_log(path, 100.0, rng, noise_m=wheel_noise_m))
    gyro = inertial(path, InertialErrors(), rng, on_wall=True)
    tracker = camera(path, CameraErrors(rate_hz=camera_rate_hz), rng)
    if outliers:
        wheels, tracker = with_outliers(wheels, tracker, rng)
    mocap = []
    for k, (t, pose) in enumerate(zip(path.t_s[::50], path.pose[::50], strict=True)):
        t_ns = round(t * NS_PER_S)
        mocap.append(PoseMeasurement(Stamp(t_ns, t_ns + 4_000_000, k), "mocap", pose, 3, True))
    begin_ns = round(path.t_s[0] * NS_PER_S) - 1
    end_ns = round(path.t_s[-1] * NS_PER_S)
    parts = tuple(cycles(begin_ns + 10_000_000, end_ns, wheels, gyro, tracker, mocap))
    return Drive(start_state(begin_ns, path.pose[0]), parts, path)
