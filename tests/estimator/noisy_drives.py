"""Samples of a robot that rests, drives along both axes, turns and rests again, with noise that is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.core.signals import GyroMeasurement, Measurements, PoseMeasurement, Stamp, WheelMeasurement
from hil.robot.kinematics import WheelGeometry, inverse

GEOMETRY = WheelGeometry.nominal()
FINE_S, CYCLE_S = 0.005, 0.01


@dataclass(frozen=True)
class Noise:
    """One sigma of each: as the fields of `hil.estimator.sensor_noise.SensorNoise`."""

    gyro: float = 2e-3
    camera_position: float = 4e-4
    camera_heading: float = 6e-4
    camera_walk: float = 1.5e-3
    camera_turn: float = 3e-4
    mocap_position: float = 1e-5
    mocap_heading: float = 4e-5
    wheel_step: float = 1.2e-5
    camera_scale: float = 1.01


def twist_at(t_s):
    """Rest, ahead, to the left, a turn, back, rest: body twist (3,) at a time of 28 s."""
    for begin, end, twist in (
        (4, 10, (0.08, 0, 0)),
        (11, 17, (0, 0.08, 0)),
        (18, 20, (0, 0, 0.1)),
        (21, 26, (-0.08, 0.02, 0)),
    ):
        if begin <= t_s < end:
            ramp = min(1.0, (t_s - begin) / 0.2, (end - t_s) / 0.2)
            return ramp * np.array(twist, dtype=np.float64)
    return np.zeros(3)


def driven(true: Noise, seed: int, end_s: float = 28.0) -> tuple[Measurements, ...]:
    """Cycles of 10 ms; the camera at 200 Hz, everything else once a cycle."""
    rng = np.random.default_rng(seed)
    pose, seen, wheel, drift = np.zeros(3), np.zeros(2), np.zeros(4), 0.0
    cycles, count, camera = [], round(end_s / FINE_S), []
    steering = np.zeros(4)
    for k in range(count):
        t_s = k * FINE_S
        twist = twist_at(t_s)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        step = np.array([c * twist[0] - s * twist[1], s * twist[0] + c * twist[1]]) * FINE_S
        pose = pose + np.append(step, twist[2] * FINE_S)
        drift += true.camera_turn * np.sqrt(FINE_S) * rng.standard_normal()
        way = float(np.hypot(*step))
        turn = np.array([[np.cos(drift), -np.sin(drift)], [np.sin(drift), np.cos(drift)]])
        seen = (
            seen + true.camera_scale * turn @ step + true.camera_walk * np.sqrt(way) * rng.standard_normal(2)
        )
        if np.any(twist):
            speed, angle = inverse(GEOMETRY, twist)
            flipped = np.abs(angle) > np.pi / 2 + 0.1
            steering = np.where(flipped, angle - np.pi * np.sign(angle), angle)
            wheel = wheel + np.where(flipped, -1.0, 1.0) * speed / GEOMETRY.radius_m * FINE_S
        now_ns = round(1e9 * (t_s + FINE_S))
        stamp = Stamp(now_ns, now_ns, k)
        noisy = np.append(
            seen + true.camera_position * rng.standard_normal(2),
            pose[2] + drift + true.camera_heading * rng.standard_normal(),
        )
        camera.append(PoseMeasurement(stamp, "tracker", noisy, 3, True))
        if k % 2:
            truth = pose + np.array([true.mocap_position] * 2 + [true.mocap_heading]) * rng.standard_normal(3)
            angles = wheel + true.wheel_step / np.sqrt(2.0) / GEOMETRY.radius_m * rng.standard_normal(4)
            cycles.append(
                Measurements(
                    k // 2,
                    now_ns,
                    (WheelMeasurement(stamp, angles, np.zeros(4), steering, (True,) * 4),),
                    (GyroMeasurement(stamp, twist[2] + true.gyro * rng.standard_normal(), 0.0, np.zeros(2)),),
                    tuple(camera),
                    (PoseMeasurement(stamp, "mocap", truth, 3, True),),
                )
            )
            camera = []
    return tuple(cycles)
