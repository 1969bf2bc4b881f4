"""What may enter the filter: measurements of a cycle turned into event rows, bad ones refused by name.

Each sensor packs its own samples. Counts are by reason and part of the diagnostics: `rejected_not_finite`,
`rejected_late`, ...
"""

from __future__ import annotations

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.estimator.clocks import SensorClock
from hil.estimator.layout import ROW, ROW_FLOATS, Ints
from hil.estimator.records import part_of
from hil.estimator.sensors import SENSORS
from hil.vocabulary.clock import nanoseconds
from hil.vocabulary.signals import Measurements, Stamp

REASONS = ("not_finite", "implausible", "shape", "late", "future", "duplicate")
_ROOM = 64


class Staged:
    """Room for the usable samples of one cycle, in the order in which they came.

    Attributes:
        count: how many there are.
        t_ns, numbers, seqs: (room,) stamps, numbers of sensors, sequence numbers.
        data: (room, floats of a row) event rows.
    """

    def __init__(self, room: int) -> None:
        self.count = 0
        self.t_ns: Ints = np.zeros(room, dtype=np.int64)
        self.numbers: Ints = np.zeros(room, dtype=np.int64)
        self.seqs: Ints = np.zeros(room, dtype=np.int64)
        self.data = np.zeros((room, ROW_FLOATS))


class Intake:
    """Checks samples and puts them into rows; stamps pass the sensor clocks."""

    def __init__(self, config: EstimatorConfig) -> None:
        self._future_ns = nanoseconds(config.time.future_s)
        self._estimated = config.time.clock == "estimated"
        self._sensors = [
            (number, sensor.NAME, sensor.pack, part_of(ROW, sensor.NAME))
            for number, sensor in enumerate(SENSORS, start=1)
            if sensor.is_used(config)
        ]
        self._staged = Staged(_ROOM)
        self.reset()

    def reset(self) -> None:
        """Forget counts and clocks."""
        self.refused = dict.fromkeys(REASONS, 0)
        self.clocks = {sensor.NAME: SensorClock() for sensor in SENSORS}
        self.last_ns: dict[str, int] = {}

    def stage(self, measurements: Measurements, oldest_ns: int) -> Staged:
        """Usable samples of a cycle; good until the next call."""
        came = [getattr(measurements, name) for _, name, _, _ in self._sensors]
        staged, many = self._staged, sum(map(len, came))
        if many > len(staged.t_ns):
            staged = self._staged = Staged(2 * many)
        staged.count = 0
        staged.data[:many] = 0.0
        newest_ns = measurements.t_ns + self._future_ns
        for (number, name, pack, part), samples in zip(self._sensors, came, strict=True):
            for sample in samples:
                reason = pack(sample, staged.data[staged.count, part])
                if reason:
                    self.refused[reason] += 1
                    staged.data[staged.count] = 0.0
                else:
                    self._keep(staged, number, name, sample.stamp, oldest_ns, newest_ns)
        return staged

    def _keep(
        self, staged: Staged, number: int, name: str, stamp: Stamp, oldest_ns: int, newest_ns: int
    ) -> None:
        """Let the row in that was filled last, unless it is from another time."""
        t_ns, last_ns = stamp.t_ns, self.last_ns
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
            staged.t_ns[k], staged.numbers[k], staged.seqs[k] = t_ns, number, stamp.seq
            staged.count = k + 1
