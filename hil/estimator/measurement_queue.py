"""Intake of the filter: turns a cycle's measurements into event rows and counts refused samples by reason.

Each sensor module packs its own samples. The counts are part of the diagnostics: `rejected_not_finite`,
`rejected_late`, ...
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from operator import attrgetter

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.named_records import FLOAT_BYTES, part_of
from hil.core.signals import Measurements, Stamp
from hil.estimator.kernel_layout import ROW, ROW_FLOATS, Samples
from hil.estimator.sensors import SENSORS
from hil.estimator.sensors.sensor import Sensor

_BLOCK_NS = 5 * NS_PER_S
_BLOCKS = 60
_LEAST_BLOCKS = 3


class SensorClock:
    """Estimates a sensor clock's offset and drift against the host's, by the least delay per 5 s block."""

    def __init__(self) -> None:
        self._start_ns: int | None = None
        self._block = 0
        self._least_ns = 0
        self._ends_s: list[float] = []
        self._envelope_s: list[float] = []
        self.drift = 0.0
        self.offset_s = 0.0
        self._first_s = 0.0

    def add(self, t_ns: int, host_ns: int) -> None:
        """Add one sample's stamp and receive time; samples of an already closed block are ignored."""
        if self._start_ns is None:
            self._start_ns, self._least_ns = host_ns, host_ns - t_ns
            return
        block = (host_ns - self._start_ns) // _BLOCK_NS
        if block < self._block:
            return
        if block > self._block:
            self._close()
            self._block, self._least_ns = block, host_ns - t_ns
        self._least_ns = min(self._least_ns, host_ns - t_ns)

    def _close(self) -> None:
        middle_s = (self._block + 0.5) * _BLOCK_NS / NS_PER_S
        if not self._ends_s:
            self._first_s = self._least_ns / NS_PER_S
        self._ends_s.append(middle_s)
        self._envelope_s.append(self._least_ns / NS_PER_S - self._first_s)
        del self._ends_s[:-_BLOCKS], self._envelope_s[:-_BLOCKS]
        if len(self._ends_s) < _LEAST_BLOCKS:
            return
        at, delay = np.array(self._ends_s), np.array(self._envelope_s)
        centre = at.mean()
        self.drift = float(np.dot(at - centre, delay) / np.dot(at - centre, at - centre))
        self.offset_s = float(delay.mean() - self.drift * centre)

    def correction_ns(self, t_ns: int) -> int:
        """Correction to add to a stamp, so that it follows the host's clock as at the start; ns."""
        if self._start_ns is None or len(self._ends_s) < _LEAST_BLOCKS:
            return 0
        since_s = (t_ns - self._start_ns) / NS_PER_S
        return round((self.offset_s + self.drift * since_s) * NS_PER_S)


REASONS = ("not_finite", "implausible", "shape", "late", "future", "duplicate")
_ROOM = 64
_ROW_BYTES = FLOAT_BYTES * ROW_FLOATS


class Batch:
    """Buffer for the usable samples of one cycle, in order of arrival.

    Attributes:
        count: number of samples in the buffer.
        samples: the arrays.
        memory: memory views of the four arrays; writing a number takes a fifth of numpy's time.
    """

    def __init__(self, room: int) -> None:
        self.count = 0
        t_ns, numbers, seqs = np.zeros((3, room), np.int64)
        self.samples = Samples(t_ns, numbers, seqs, np.zeros((room, ROW_FLOATS)))
        self.memory = tuple(array.data for array in self.samples)

    def doubled(self) -> Batch:
        """A buffer twice as large with the same content."""
        other = Batch(2 * len(self.samples.t_ns))
        for to, of in zip(other.samples, self.samples, strict=True):
            to[: len(of)] = of
        return other


class MeasurementQueue:
    """Checks samples, corrects their stamps and packs them into event rows."""

    def __init__(self, config: EstimatorConfig) -> None:
        self._future_ns = nanoseconds(config.time.future_s)
        self._estimated = config.time.clock == "estimated"
        self._sensors = [
            (number, sensor.NAME, attrgetter(sensor.NAME), sensor.pack, _filling(sensor))
            for number, sensor in enumerate(SENSORS, start=1)
            if sensor.is_used(config)
        ]
        self._staged = Batch(_ROOM)
        self.reset()

    def reset(self) -> None:
        """Reset the counts of refused samples (floats, as all diagnostics) and the sensor clocks."""
        self.refused = dict.fromkeys(REASONS, 0.0)
        self.clocks: Mapping[str, SensorClock] = {sensor.NAME: SensorClock() for sensor in SENSORS}
        self.last_ns: dict[str, int] = {}

    def stage(self, measurements: Measurements, oldest_ns: int) -> Batch:
        """Usable samples of a cycle; valid until the next call."""
        staged, count = self._staged, 0
        stamps, numbers, seqs, rows = staged.memory
        newest_ns, last_ns = measurements.t_ns + self._future_ns, self.last_ns
        for number, name, samples, pack, fill in self._sensors:
            for sample in samples(measurements):
                row = pack(sample)
                if isinstance(row, str):
                    self.refused[row] += 1.0
                    continue
                stamp = sample.stamp
                t_ns = self._corrected_ns(name, stamp) if self._estimated else stamp.t_ns
                if t_ns <= oldest_ns:
                    self.refused["late"] += 1.0
                elif t_ns > newest_ns:
                    self.refused["future"] += 1.0
                else:
                    if t_ns > last_ns.get(name, t_ns - 1):
                        last_ns[name] = t_ns
                    if count == len(stamps):
                        staged = self._staged = staged.doubled()
                        stamps, numbers, seqs, rows = staged.memory
                    stamps[count], numbers[count], seqs[count] = t_ns, number, stamp.seq
                    fill(rows, count * _ROW_BYTES, *row)
                    count += 1
        staged.count = count
        return staged

    def _corrected_ns(self, name: str, stamp: Stamp) -> int:
        """Stamp corrected to the host's clock, ns; also updates the clock estimate of the sensor."""
        clock = self.clocks[name]
        clock.add(stamp.t_ns, stamp.host_ns)
        return stamp.t_ns + clock.correction_ns(stamp.t_ns)


def _filling(sensor: Sensor) -> Callable[..., None]:
    """Function that writes a sensor's floats into memory as a whole event row, zero elsewhere."""
    part = part_of(ROW, sensor.NAME)
    before, behind = FLOAT_BYTES * part.start, FLOAT_BYTES * (ROW_FLOATS - part.stop)
    return struct.Struct(f"{before}x{part.stop - part.start}d{behind}x").pack_into
