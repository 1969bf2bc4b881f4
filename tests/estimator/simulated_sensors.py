"""Simulated gyro, camera and wheels along a known path, for judging estimators without a robot.

Not an emulated device: no wire, no plant, only errors of the size that arXiv 2509.04016 gives and
the authors' recordings show, on top of a path that came from motion capture or was computed. Randomness is an
argument; the same generator state gives the same samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.geometry import Array, between
from hil.core.signals import (
    GyroMeasurement,
    Measurements,
    PoseMeasurement,
    RobotState,
    Stamp,
    WheelMeasurement,
)

_LSB_RAD_S = np.deg2rad(1.0 / 16.0)
_SMOOTH_S = 0.1


@dataclass(frozen=True)
class CameraErrors:
    """Tracking camera: scale error, drift per rolled metre, yaw drift, white noise, latency."""

    rate_hz: float = 200.0
    latency_s: float = 0.02
    scale_sigma: float = 0.005
    position_m: float = 1e-3
    heading_rad: float = 1e-3
    drift_per_sqrt_m: float = 2e-3
    yaw_drift_per_sqrt_s: float = 7e-4


@dataclass(frozen=True)
class InertialErrors:
    """Gyro and gravity heading: noise, constant errors, quantisation of the chip, latency."""

    rate_hz: float = 100.0
    latency_s: float = 0.002
    rate_rad_s: float = 2.5e-3
    bias_sigma_rad_s: float = 5e-3
    bias_rad_s_sqrt_s: float = 2e-5
    gravity_rad: float = 5e-3
    gravity_offset_rad: float = 3e-3


@dataclass(frozen=True)
class Path:
    """True poses (n, 3) at times (n,) s, strictly increasing."""

    t_s: Array
    pose: Array

    def at(self, t_s: Array) -> Array:
        """Poses (n, 3) at times (n,), s, by linear interpolation."""
        return np.column_stack([np.interp(t_s, self.t_s, column) for column in self.pose.T])

    def yaw_rate(self, t_s: Array) -> Array:
        """Yaw rate (n,), rad/s, the mean over 0.1 s: the path's own noise is not taken for motion."""
        ahead = np.interp(t_s + 0.5 * _SMOOTH_S, self.t_s, self.pose[:, 2])
        behind = np.interp(t_s - 0.5 * _SMOOTH_S, self.t_s, self.pose[:, 2])
        return np.asarray((ahead - behind) / _SMOOTH_S, dtype=np.float64)


def _grid(path: Path, rate_hz: float) -> Array:
    count = int((path.t_s[-1] - path.t_s[0]) * rate_hz)
    return np.asarray(path.t_s[0] + np.arange(1, count) / rate_hz, dtype=np.float64)


def _stamp(t_s: float, latency_s: float, seq: int) -> Stamp:
    return Stamp(round(t_s * NS_PER_S), round((t_s + latency_s) * NS_PER_S), seq)


def camera(path: Path, errors: CameraErrors, rng: np.random.Generator) -> tuple[PoseMeasurement, ...]:
    """Camera poses of the body in the body frame at the camera's first sample."""
    t_s = _grid(path, errors.rate_hz)
    truth = path.at(t_s)
    scale = 1.0 + errors.scale_sigma * rng.normal()
    step = np.diff(truth, axis=0)
    length = np.hypot(step[:, 0], step[:, 1])
    yaw_walk = errors.yaw_drift_per_sqrt_s / np.sqrt(errors.rate_hz) * rng.normal(size=len(step))
    error = np.concatenate([[0.0], np.cumsum(yaw_walk)])
    c, s = np.cos(error[:-1]), np.sin(error[:-1])
    walk = errors.drift_per_sqrt_m * np.sqrt(length)[:, None] * rng.normal(size=(len(step), 2))
    dx = scale * (c * step[:, 0] - s * step[:, 1]) + walk[:, 0]
    dy = scale * (s * step[:, 0] + c * step[:, 1]) + walk[:, 1]
    seen = truth.copy()
    seen[1:, 0], seen[1:, 1] = truth[0, 0] + np.cumsum(dx), truth[0, 1] + np.cumsum(dy)
    seen[:, 2] += error
    sigma = np.array([errors.position_m, errors.position_m, errors.heading_rad])
    seen += sigma * rng.normal(size=seen.shape)
    start = seen[0].copy()
    return tuple(
        PoseMeasurement(_stamp(t, errors.latency_s, k), "tracker", between(start, pose), 3, True)
        for k, (t, pose) in enumerate(zip(t_s.tolist(), seen, strict=True))
    )


def inertial(
    path: Path, errors: InertialErrors, rng: np.random.Generator, *, on_wall: bool
) -> tuple[GyroMeasurement, ...]:
    """Gyro samples, with the gravity heading on the wall."""
    t_s = _grid(path, errors.rate_hz)
    n = len(t_s)
    walk = errors.bias_rad_s_sqrt_s / np.sqrt(errors.rate_hz) * rng.normal(size=n)
    bias = errors.bias_sigma_rad_s * rng.normal() + np.cumsum(walk)
    rate = path.yaw_rate(t_s) + bias + errors.rate_rad_s * rng.normal(size=n)
    rate = np.round(rate / _LSB_RAD_S) * _LSB_RAD_S
    heading = np.full(n, np.nan)
    if on_wall:
        offset = errors.gravity_offset_rad * rng.normal()
        heading = path.at(t_s)[:, 2] + offset + errors.gravity_rad * rng.normal(size=n)
    still = np.zeros(2)
    return tuple(
        GyroMeasurement(_stamp(t, errors.latency_s, k), float(r), float(h), still)
        for k, (t, r, h) in enumerate(zip(t_s.tolist(), rate, heading, strict=True))
    )


def wheel_samples(
    t_s: Array, angle_rad: Array, steering_rad: Array, rate_rad_s: Array, *, latency_s: float = 0.001
) -> tuple[WheelMeasurement, ...]:
    """Servo reads of arrays (n,), (n, 4), (n, 4), (n, 4)."""
    ok = (True,) * 4
    return tuple(
        WheelMeasurement(_stamp(t, latency_s, k), a, w, d, ok)
        for k, (t, a, d, w) in enumerate(zip(t_s.tolist(), angle_rad, steering_rad, rate_rad_s, strict=True))
    )


Sample = TypeVar("Sample", WheelMeasurement, GyroMeasurement, PoseMeasurement)


class _Queue(Generic[Sample]):
    """Samples of one sensor in the order of their arrival."""

    def __init__(self, samples: Sequence[Sample]) -> None:
        self._samples: list[Sample] = sorted(samples, key=lambda m: m.stamp.host_ns)
        self._arrival_ns = np.array([m.stamp.host_ns for m in self._samples], dtype=np.int64)
        self._done = 0

    def until(self, t_ns: int) -> tuple[Sample, ...]:
        """What has arrived since the last call and by `t_ns`."""
        begin, self._done = self._done, int(np.searchsorted(self._arrival_ns, t_ns, side="right"))
        return tuple(self._samples[begin : self._done])


def cycles(
    start_ns: int,
    end_ns: int,
    wheels: Sequence[WheelMeasurement] = (),
    gyro: Sequence[GyroMeasurement] = (),
    tracker: Sequence[PoseMeasurement] = (),
    mocap: Sequence[PoseMeasurement] = (),
    period_ns: int = 10_000_000,
) -> Iterator[Measurements]:
    """Measurements per control cycle: each sample in the first cycle at or after its receive time."""
    w, g, t, c = _Queue(wheels), _Queue(gyro), _Queue(tracker), _Queue(mocap)
    for cycle, t_ns in enumerate(range(start_ns, end_ns, period_ns)):
        yield Measurements(cycle, t_ns, w.until(t_ns), g.until(t_ns), t.until(t_ns), c.until(t_ns))


def start_state(t_ns: int, pose: Array, position_m: float = 1e-3, heading_rad: float = 1e-3) -> RobotState:
    """A start at rest at a pose (3,) that is known this well."""
    sigma = np.array([position_m, position_m, heading_rad, 1e-3, 1e-3, 1e-3])
    return RobotState(t_ns, np.asarray(pose, dtype=np.float64), np.zeros(3), np.diag(sigma**2))
