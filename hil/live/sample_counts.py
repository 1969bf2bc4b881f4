"""Counts what the devices delivered to a loop and what is missing: good, bad, and gaps in the numbering."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import Any

from hil.core.interfaces import Sink
from hil.core.registry import heard_in
from hil.core.signals import CycleRecord, Status, worst


@dataclass
class SampleCount:
    """Samples of one device.

    Attributes:
        received: all of them; `bad` by status, of those in which any channel is not OK.
        missing: numbers that the source has given and that never came.
    """

    received: int = 0
    missing: int = 0
    bad: Counter[str] = field(default_factory=Counter)
    last_seq: int | None = None

    def add(self, sample: Any) -> None:
        """Count one sample."""
        self.received += 1
        last, self.last_seq = self.last_seq, sample.stamp.seq
        if last is not None and self.last_seq - last > 1:
            self.missing += self.last_seq - last - 1
        status = worst(sample)
        if status is not Status.OK:
            self.bad[status.value] += 1

    def to_json(self) -> dict[str, object]:
        """As plain data."""
        return {"received": self.received, "missing": self.missing, "bad": dict(self.bad)}


class SampleCounter(Sink):
    """Sink that counts."""

    def __init__(self) -> None:
        self.counts: defaultdict[str, SampleCount] = defaultdict(SampleCount)

    def write(self, record: CycleRecord) -> None:
        """Count one cycle's samples."""
        for name in heard_in(record.inputs):
            for sample in record.inputs.of(name):
                self.counts[name].add(sample)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def to_json(self) -> dict[str, dict[str, object]]:
        """As plain data, by device."""
        return {name: count.to_json() for name, count in self.counts.items()}
