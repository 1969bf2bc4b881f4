"""Normalised innovations (NIS) of the sensors during a run: a table in reports of runs with a filter."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from hil.core.clock import nanoseconds
from hil.core.interfaces import Sink
from hil.core.signals import CycleRecord

TITLE = "How the sensors fit the estimate"
HEAD = ("sensor", "mean NIS", "expected", "its noise is")
BAND = (0.5, 2.0)
"""Range of the mean NIS per row in which a sensor is as noisy as the filter assumes; 1 is ideal."""
_SENSORS: Mapping[str, str] = {
    "wheels": "wheels",
    "gyro": "gyro",
    "tracker": "camera",
    "mocap": "motion capture",
}
_SETTLED_NS, _GAP_NS = nanoseconds(2.0), nanoseconds(0.5)
_SILENT_S = 1.0
_FEWEST = 100


def verdict(nis: float) -> str:
    """Return how a sensor's noise compares with the noise that the estimator assumes, from its mean NIS."""
    low, high = BAND
    if nis > high:
        return f"about {nis**0.5:.1f} times the assumed"
    return f"about 1/{nis**-0.5:.1f} of the assumed" if nis < low else "as assumed"


class FitHistory(Sink):
    """Averages each sensor's NIS while the robot drives with a filter, across all benches of a run.

    The first two seconds of a drive are skipped: the running means of the filter begin at 1.
    """

    def __init__(self) -> None:
        self._sums: dict[str, tuple[float, int]] = {}
        self._began_ns = self._last_ns = -_GAP_NS

    def write(self, record: CycleRecord) -> None:
        """Add the NIS values of one record."""
        if record.reference is None:
            return
        t_ns, figures = record.inputs.t_ns, record.state.diagnostics
        if not self._last_ns <= t_ns < self._last_ns + _GAP_NS or record.cycle == 0:
            self._began_ns = t_ns
        self._last_ns = t_ns
        if t_ns - self._began_ns < _SETTLED_NS:
            return
        for name in _SENSORS:
            nis = figures.get(f"nis_mean_{name}")
            if nis is not None and figures.get(f"age_{name}_s", _SILENT_S) < _SILENT_S:
                before, count = self._sums.get(name, (0.0, 0))
                self._sums[name] = before + nis, count + 1

    def follow(self, later: FitHistory) -> None:
        """Add the values of benches that were driven in another process."""
        for name, (nis, count) in later._sums.items():
            before, counted = self._sums.get(name, (0.0, 0))
            self._sums[name] = before + nis, counted + count

    def close(self) -> None:
        """Do nothing; the next bench continues the history."""

    def means(self) -> dict[str, float]:
        """Return the mean NIS per row by sensor, without sensors that have too few samples."""
        return {name: total / count for name, (total, count) in self._sums.items() if count >= _FEWEST}

    def rows(self) -> Iterator[tuple[str, str, str, str]]:
        """Return the rows of the table as text; none if no filter was used."""
        for name, nis in self.means().items():
            yield _SENSORS[name], f"{nis:.2f}", f"{BAND[0]:g} to {BAND[1]:g}", verdict(nis)
