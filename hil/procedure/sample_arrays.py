"""Extracts arrays from the samples in a motion's records: stamps, arrival times and values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from hil.config.bench import BenchConfig
from hil.config.encoders import EncodersConfig
from hil.core.clock import NS_PER_S
from hil.core.geometry import Array, wrap_array
from hil.core.signals import Stamp, Status, worst
from hil.loop.driven_motion import Motion


@dataclass(frozen=True)
class Series:
    """Usable samples of one device, oldest first.

    Attributes:
        t_s: time of measurement, s since the motion's first cycle, shape (n,).
        host_s: time of arrival, same axis, shape (n,).
        device_s: time of the device's own clock since its first sample, s; NaN without a device clock.
        values: values (n, k) of the samples.
        seen: number of received samples, usable or not.
    """

    t_s: Array
    host_s: Array
    device_s: Array
    values: Array
    seen: int

    def __len__(self) -> int:
        return len(self.t_s)

    def __getitem__(self, column: int) -> Array:
        return np.asarray(self.values[:, column], dtype=np.float64)

    def since(self, t_s: float) -> Series:
        """Return only samples measured from `t_s` on: queues may hold older samples when a motion begins."""
        keep = self.t_s >= t_s
        return Series(
            self.t_s[keep], self.host_s[keep], self.device_s[keep], self.values[keep], int(keep.sum())
        )

    def later(self, by_s: float) -> Series:
        """Return the same samples on a time axis that begins `by_s` earlier."""
        return replace(self, t_s=self.t_s + by_s, host_s=self.host_s + by_s)

    def between(self, begin_s: float, end_s: float) -> Array:
        """Return the mean row of a time interval, (k,); NaN without usable samples."""
        rows = self.values[(self.t_s >= begin_s) & (self.t_s < end_s)]
        return rows.mean(axis=0) if len(rows) else np.full(self.values.shape[1], np.nan)

    def at(self, t_s: Array, column: int) -> Array:
        """Interpolate one column at `t_s`, same shape; NaN outside the data."""
        if len(self) < 2:
            return np.full(len(t_s), np.nan)
        return np.interp(t_s, self.t_s, self[column], left=np.nan, right=np.nan)

    def mean(self, column: int) -> float:
        """Return the mean of a column; NaN without samples."""
        return float(self[column].mean()) if len(self) else float("nan")


def _series(motion: Motion, rows: Iterable[tuple[Stamp, bool, Array]], width: int) -> Series:
    origin_ns = motion.records[0].inputs.t_ns
    every = list(rows)
    used = [(stamp, row) for stamp, usable, row in every if usable]
    stamps = [stamp for stamp, _ in used]
    first_ns = next((s.device_ns for s in stamps if s.device_ns is not None), 0)
    device = [np.nan if s.device_ns is None else (s.device_ns - first_ns) / NS_PER_S for s in stamps]
    values = np.array([row for _, row in used], dtype=np.float64).reshape(len(used), width)
    return Series(
        np.array([(s.t_ns - origin_ns) / NS_PER_S for s in stamps], dtype=np.float64),
        np.array([(s.host_ns - origin_ns) / NS_PER_S for s in stamps], dtype=np.float64),
        np.array(device, dtype=np.float64),
        values,
        len(every),
    )


def arrivals(motion: Motion, kind: str) -> Series:
    """Return arrival times of the samples of any kind of device, without values, (n, 0)."""
    return _series(
        motion,
        ((s.stamp, worst(s) is Status.OK, np.empty(0)) for r in motion.records for s in r.inputs.of(kind)),
        0,
    )


def wheels(motion: Motion) -> Series:
    """Return aligned wheels: angle (0-3), rate (4-7), steering (8-11), wheel order."""
    return _series(
        motion,
        (
            (w.stamp, all(w.valid), np.concatenate([w.wheel_angle_rad, w.wheel_rate_rad_s, w.steering_rad]))
            for r in motion.records
            for w in r.measurements.wheels
        ),
        12,
    )


def encoders(motion: Motion, config: BenchConfig) -> Series:
    """Steering by the external encoders, bench signs and zeros applied, (n, 4); NaN per unusable axis."""
    table = config.of(EncodersConfig)
    assert table is not None
    sign, zero = np.array(table.sign, dtype=np.float64), np.array(table.zeros_rad)
    return _series(
        motion,
        (
            (e.stamp, any(s is Status.OK for s in e.status), wrap_array(sign * (e.angle_rad - zero)))
            for r in motion.records
            for e in r.inputs.encoders
        ),
        4,
    )


def inertial(motion: Motion) -> Series:
    """Body yaw rate (0), gravity heading (1); sensor axes: gyro (2-4), gravity (5-7), linear (8-10)."""
    aligned = {g.stamp.seq: g for r in motion.records for g in r.measurements.gyro}
    rows = []
    for record in motion.records:
        for s in record.inputs.imu:
            g = aligned.get(s.stamp.seq)
            ok = s.status is Status.OK and g is not None
            head = (g.yaw_rate_rad_s, g.gravity_heading_rad) if g is not None else (np.nan, np.nan)
            raw = np.concatenate([head, s.gyro_rad_s, s.gravity_m_s2, s.linear_acceleration_m_s2])
            rows.append((s.stamp, ok, raw))
    return _series(motion, rows, 11)


def poses(motion: Motion, source: str) -> Series:
    """Return aligned body poses (x, y, heading) of `mocap` or `tracker`."""
    return _series(
        motion,
        ((m.stamp, m.valid, m.pose) for r in motion.records for m in getattr(r.measurements, source)),
        3,
    )


def camera(motion: Motion) -> Series:
    """Return raw camera samples: position (0-2), quaternion wxyz (3-6), velocity (7-9), turn rate (10-12)."""
    return _series(
        motion,
        (
            (
                s.stamp,
                s.status is Status.OK,
                np.concatenate([s.position_m, s.quaternion_wxyz, s.velocity_m_s, s.angular_velocity_rad_s]),
            )
            for r in motion.records
            for s in r.inputs.tracker
        ),
        13,
    )


def integrated(t_s: Array, rate: Array) -> Array:
    """Integrate a rate signal over time."""
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t_s)
    return np.concatenate([np.zeros(min(len(rate), 1)), np.cumsum(steps)])
