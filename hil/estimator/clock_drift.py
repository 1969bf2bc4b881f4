"""Offset and drift of a sensor's clock against the host's, from stamps and receive times.

A sample cannot arrive before it was measured, and now and then one arrives with little delay: the lower
envelope of receive time minus stamp follows offset plus least delay, free of jitter (a real T265:
-54.8 ms in 65 min, receive jitter to 200 ms). The envelope is kept as minima over short blocks; a line
through the blocks of the last minutes gives the drift. The first block counts as aligned, so the
correction removes what the clock has drifted since.
"""

from __future__ import annotations

import numpy as np

from hil.core.clock import NS_PER_S

_BLOCK_NS = 5 * NS_PER_S
_BLOCKS = 60
_LEAST_BLOCKS = 3


class SensorClock:
    """Follows one sensor's clock."""

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
        """Note one sample's stamp and receive time; samples of a block that is over are ignored."""
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
        """What to add to a stamp so that it follows the host's clock as it did at the start."""
        if self._start_ns is None or len(self._ends_s) < _LEAST_BLOCKS:
            return 0
        since_s = (t_ns - self._start_ns) / NS_PER_S
        return round((self.offset_s + self.drift * since_s) * NS_PER_S)
