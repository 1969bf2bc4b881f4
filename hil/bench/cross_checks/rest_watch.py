"""Collects samples of a robot that rests or has just begun to move, until gravity can be compared."""

from collections.abc import Iterable
from typing import Any

from hil.bench.cross_checks.gravity import FEWEST
from hil.config.bench import BenchConfig
from hil.core.clock import nanoseconds
from hil.core.signals import CycleRecord

_SOURCES = ("imu", "tracker", "mocap")
_LONGEST_NS = nanoseconds(0.3)
"""By then a robot that begins to move has gone a few millimetres."""


class RestWatch:
    """Samples of the first cycles of a run.

    Args:
        config: configuration of the bench.

    Attributes:
        seen: samples by kind.
    """

    def __init__(self, config: BenchConfig) -> None:
        self._there = [name for name in _SOURCES if name in config.devices()]
        self.seen: dict[str, list[Any]] = {name: [] for name in self._there}
        self._began_ns: int | None = None
        self._ended = False

    def ends(self, record: CycleRecord) -> bool:
        """Take the samples of a cycle; whether now, once, enough is known, or all that there will be."""
        if self._ended:
            return False
        if self._began_ns is None:
            self._began_ns = record.inputs.t_ns
        for name in self._there:
            self.seen[name] += record.inputs.of(name)
        enough = all(len(samples) > FEWEST for samples in self.seen.values())
        self._ended = enough or record.inputs.t_ns - self._began_ns >= _LONGEST_NS
        return self._ended


def samples_of(records: Iterable[CycleRecord], names: Iterable[str]) -> dict[str, list[Any]]:
    """All samples of a run by kind.

    Args:
        records: cycles of the run.
        names: kinds.
    """
    seen: dict[str, list[Any]] = {name: [] for name in names}
    for record in records:
        for name, samples in seen.items():
            samples += record.inputs.of(name)
    return seen
