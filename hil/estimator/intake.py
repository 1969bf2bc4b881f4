"""What may enter the filter: measurements of a cycle turned into event rows, bad ones refused by name.

Counts are by name and part of the diagnostics: `rejected_not_finite`, `rejected_late`, ... What is finite but
beyond any robot (`_FARTHEST_M` and so on) would leave no digits for the covariance: `rejected_implausible`.
"""

from __future__ import annotations

import math

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.estimator import layout as L
from hil.estimator.clocks import SensorClock
from hil.estimator.replay import Ints
from hil.vocabulary.clock import nanoseconds
from hil.vocabulary.geometry import Array
from hil.vocabulary.signals import GyroMeasurement, Measurements, PoseMeasurement, Stamp, WheelMeasurement

REASONS = ("not_finite", "implausible", "shape", "late", "future", "duplicate")
_FARTHEST_M, _FARTHEST_RAD, _FASTEST_RAD_S, _HARDEST_M_S2 = 1e3, 1e6, 1e2, 1e3
_FOUR, _THREE, _TWO = (4,), (3,), (2,)
_ROOM = 64


class Staged:
    """Room for the usable samples of one cycle, in the order in which they came.

    Attributes:
        count: how many there are.
        t_ns, kinds, seqs: (room,) stamps, sensor ids, sequence numbers.
        rows: (room, 16) event rows.
    """

    def __init__(self, room: int) -> None:
        self.count = 0
        self.t_ns: Ints = np.zeros(room, dtype=np.int64)
        self.kinds: Ints = np.zeros(room, dtype=np.int64)
        self.seqs: Ints = np.zeros(room, dtype=np.int64)
        self.rows = np.zeros((room, L.ROW_DATA))


class Intake:
    """Checks samples and puts them into rows; stamps pass the sensor clocks."""

    def __init__(self, config: EstimatorConfig) -> None:
        self._future_ns = nanoseconds(config.time.future_s)
        self._estimated = config.time.clock == "estimated"
        self._use_mocap = config.mocap.use
        self._staged = Staged(_ROOM)
        self.reset()

    def reset(self) -> None:
        """Forget counts and clocks."""
        self.refused = dict.fromkeys(REASONS, 0)
        self.clocks = {name: SensorClock() for name in L.SENSORS[1:]}
        self.last_ns: dict[str, int] = {}

    def stage(self, measurements: Measurements, oldest_ns: int) -> Staged:
        """Usable samples of a cycle; good until the next call."""
        wheels, gyro, tracker = measurements.wheels, measurements.gyro, measurements.tracker
        mocap = measurements.mocap if self._use_mocap else ()
        staged, many = self._staged, len(wheels) + len(gyro) + len(tracker) + len(mocap)
        if many > len(staged.t_ns):
            staged = self._staged = Staged(2 * many)
        staged.count = 0
        newest_ns = measurements.t_ns + self._future_ns
        for w in wheels:
            if self._wheels(w, staged.rows[staged.count]):
                self._keep(staged, L.WHEELS, w.stamp, oldest_ns, newest_ns)
        for g in gyro:
            if self._gyro(g, staged.rows[staged.count]):
                self._keep(staged, L.GYRO, g.stamp, oldest_ns, newest_ns)
        for kind, poses in ((L.TRACKER, tracker), (L.MOCAP, mocap)):
            for p in poses:
                if self._pose(p, staged.rows[staged.count]):
                    self._keep(staged, kind, p.stamp, oldest_ns, newest_ns)
        return staged

    def _keep(self, staged: Staged, kind: int, stamp: Stamp, oldest_ns: int, newest_ns: int) -> None:
        """Let the row in that was filled last, unless it is from another time."""
        name, t_ns, last_ns = L.SENSORS[kind], stamp.t_ns, self.last_ns
        if self._estimated:
            clock = self.clocks[name]
            clock.add(t_ns, stamp.host_ns)
            t_ns += clock.correction_ns(t_ns)
        if t_ns <= oldest_ns:
            self.refused["late"] += 1
        elif t_ns > newest_ns:
            self.refused["future"] += 1
        else:
            if t_ns > last_ns.get(name, t_ns - 1):
                last_ns[name] = t_ns
            k = staged.count
            staged.t_ns[k], staged.kinds[k], staged.seqs[k] = t_ns, kind, stamp.seq
            staged.count = k + 1

    def _wheels(self, sample: WheelMeasurement, row: Array) -> bool:
        turned, steered = np.asarray(sample.wheel_angle_rad), np.asarray(sample.steering_rad)
        rates, valid = np.asarray(sample.wheel_rate_rad_s), sample.valid
        if not turned.shape == steered.shape == rates.shape == _FOUR or len(valid) != 4:
            return self._refuse("shape")
        row[:4], row[4:8], row[8:12], row[12:] = turned, steered, rates, valid
        sizes = np.abs(row[:8]).tolist()
        if not sum(sizes) < _FARTHEST_RAD:
            for i in range(4):
                if not (sizes[i] < _FARTHEST_RAD and sizes[4 + i] < _FARTHEST_RAD):
                    row[12 + i] = 0.0
            valid = row[12:].tolist()
        return any(valid) or self._refuse("not_finite")

    def _gyro(self, sample: GyroMeasurement, row: Array) -> bool:
        pull = np.asarray(sample.acceleration_m_s2, dtype=np.float64)
        if pull.shape != _TWO:
            return self._refuse("shape")
        rate, heading = sample.yaw_rate_rad_s, sample.gravity_heading_rad
        if not (math.isfinite(rate) or math.isfinite(heading)):
            return self._refuse("not_finite")
        ahead, left = pull.tolist()
        if abs(rate) > _FASTEST_RAD_S or abs(heading) > _FARTHEST_RAD:
            return self._refuse("implausible")
        if not (abs(ahead) < _HARDEST_M_S2 and abs(left) < _HARDEST_M_S2):
            heading, ahead, left = math.nan, 0.0, 0.0
        row[:] = 0.0
        row[0], row[1], row[2], row[3] = rate, heading, ahead, left
        return True

    def _pose(self, sample: PoseMeasurement, row: Array) -> bool:
        pose = np.asarray(sample.pose)
        if pose.shape != _THREE:
            return self._refuse("shape")
        x_m, y_m, heading_rad = pose.tolist()
        if not math.isfinite(x_m + y_m + heading_rad):
            return self._refuse("not_finite")
        if max(abs(x_m), abs(y_m)) > _FARTHEST_M or abs(heading_rad) > _FARTHEST_RAD:
            return self._refuse("implausible")
        row[:] = 0.0
        row[:3] = pose
        row[3], row[4] = sample.quality, sample.valid
        return True

    def _refuse(self, reason: str) -> bool:
        self.refused[reason] += 1
        return False
