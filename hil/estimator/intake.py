"""What may enter the filter: measurements of a cycle turned into event rows, bad ones refused by name.

Counts are by name and part of the diagnostics: `rejected_not_finite`, `rejected_late`, ...
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hil.clock import nanoseconds
from hil.config.estimator import EstimatorConfig
from hil.estimator import layout as L
from hil.estimator.clocks import SensorClock
from hil.geometry import Array
from hil.signals import GyroMeasurement, Measurements, PoseMeasurement, Stamp, WheelMeasurement

REASONS = ("not_finite", "shape", "late", "future", "duplicate")
_FOUR = (4,)

Event = tuple[int, int, int, Array]


class Intake:
    """Checks samples and puts them into rows; stamps pass the sensor clocks."""

    def __init__(self, config: EstimatorConfig) -> None:
        self._future_ns = nanoseconds(config.time.future_s)
        self._estimated = config.time.clock == "estimated"
        self._use_mocap = config.mocap.use
        self.reset()

    def reset(self) -> None:
        """Forget counts and clocks."""
        self.refused = dict.fromkeys(REASONS, 0)
        self.clocks = {name: SensorClock() for name in L.SENSORS[1:]}
        self.last_ns: dict[str, int] = {}

    def events(self, measurements: Measurements, oldest_ns: int) -> list[Event]:
        """Usable samples of a cycle as (stamp, sensor id, sequence, row)."""
        out = []
        newest_ns, last_ns = measurements.t_ns + self._future_ns, self.last_ns
        for kind, stamp, row in self._rows(measurements):
            if row is None:
                continue
            name = L.SENSORS[kind]
            t_ns = self._stamp(name, stamp) if self._estimated else stamp.t_ns
            if t_ns <= oldest_ns:
                self.refused["late"] += 1
            elif t_ns > newest_ns:
                self.refused["future"] += 1
            else:
                last_ns[name] = max(t_ns, last_ns.get(name, t_ns))
                out.append((t_ns, kind, stamp.seq, row))
        return out

    def _stamp(self, name: str, stamp: Stamp) -> int:
        clock = self.clocks[name]
        clock.add(stamp.t_ns, stamp.host_ns)
        return stamp.t_ns + clock.correction_ns(stamp.t_ns)

    def _rows(self, measurements: Measurements) -> Iterator[tuple[int, Stamp, Array | None]]:
        for w in measurements.wheels:
            yield L.WHEELS, w.stamp, self._wheels(w)
        for g in measurements.gyro:
            yield L.GYRO, g.stamp, self._gyro(g)
        for t in measurements.tracker:
            yield L.TRACKER, t.stamp, self._pose(t)
        if self._use_mocap:
            for c in measurements.mocap:
                yield L.MOCAP, c.stamp, self._pose(c)

    def _wheels(self, sample: WheelMeasurement) -> Array | None:
        arrays = (sample.wheel_angle_rad, sample.steering_rad, sample.wheel_rate_rad_s)
        if any(np.shape(a) != _FOUR for a in arrays) or len(sample.valid) != 4:
            self.refused["shape"] += 1
            return None
        turned, steered, rates = (np.asarray(a).tolist() for a in arrays)
        usable = [
            float(ok) if math.isfinite(t) and math.isfinite(s) else 0.0
            for ok, t, s in zip(sample.valid, turned, steered, strict=True)
        ]
        if not any(usable):
            self.refused["not_finite"] += 1
            return None
        return np.array([*turned, *steered, *rates, *usable], dtype=np.float64)

    def _gyro(self, sample: GyroMeasurement) -> Array | None:
        pull = np.asarray(sample.acceleration_m_s2, dtype=np.float64)
        if pull.shape != (2,):
            self.refused["shape"] += 1
            return None
        if not (math.isfinite(sample.yaw_rate_rad_s) or math.isfinite(sample.gravity_heading_rad)):
            self.refused["not_finite"] += 1
            return None
        row = np.zeros(L.ROW_DATA)
        row[0], row[1] = sample.yaw_rate_rad_s, sample.gravity_heading_rad
        if math.isfinite(pull[0]) and math.isfinite(pull[1]):
            row[2], row[3] = pull
        else:
            row[1] = math.nan
        return row

    def _pose(self, sample: PoseMeasurement) -> Array | None:
        if np.shape(sample.pose) != (3,):
            self.refused["shape"] += 1
            return None
        row = np.zeros(L.ROW_DATA)
        row[0:3] = sample.pose
        row[3], row[4] = sample.quality, sample.valid
        if not (math.isfinite(row[0]) and math.isfinite(row[1]) and math.isfinite(row[2])):
            self.refused["not_finite"] += 1
            return None
        return row
