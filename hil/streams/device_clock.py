"""Maps a device's own time stamps to the bench clock.

Transport only ever delays, so the smallest difference of arrival and device time seen so far is the
best estimate of their offset. It rises by 100 ppm to follow a slow device clock; with 200 samples per
second and 2 ms of jitter that keeps it within a tenth of a millisecond. When a prompt sample shows that
earlier ones were late, times do not go back. An offset that is much smaller counts once two recent samples
show it: one wrong stamp would make all samples after it look late for hours.
"""

from collections import deque

_LEAK = 100e-6
_EARLIEST_NS = 250_000_000
_LATEST_NS = 5_000_000_000
_NEW_AXIS_AFTER = 20
_LEAP_NS, _RECENT = 2_000_000, 8
"""Decrease of the offset for which two of so many recent samples are needed."""
_BEGINNING_NS = -(1 << 62)


class DeviceClock:
    """Offset between one device clock and the bench clock.

    Args:
        latency_ns: smallest delay from measurement to arrival, which arrivals cannot show.
    """

    def __init__(self, latency_ns: int) -> None:
        self._latency_ns = latency_ns
        self.reset()

    def reset(self) -> None:
        """Forget the device's time axis."""
        self._known = False
        self._offset_ns = 0.0
        self._seen_ns, self._t_ns = 0, _BEGINNING_NS
        self._strange = 0
        self._recent: deque[int] = deque(maxlen=_RECENT)

    def map(self, device_ns: int, host_ns: int) -> tuple[int, bool]:
        """Bench time of a measurement stamped `device_ns` that arrived at `host_ns`.

        Returns:
            (bench time ns, whether the device's stamp was credible). A stamp far from the known
            axis is not used; when several in a row are, the device has begun a new axis.
        """
        offset_ns = host_ns - device_ns
        if not self._known:
            self._known, self._offset_ns = True, float(offset_ns)
        late_ns = offset_ns - self._offset_ns
        if not -_EARLIEST_NS < late_ns < _LATEST_NS:
            self._strange += 1
            if self._strange < _NEW_AXIS_AFTER:
                return self._forward(host_ns - self._latency_ns), False
            self._offset_ns = float(offset_ns)
            self._recent.clear()
        else:
            passed_ns = host_ns - self._seen_ns
            leaked_ns = self._offset_ns + _LEAK * (passed_ns if passed_ns > 0 else 0)
            least_ns = offset_ns
            if offset_ns < leaked_ns - _LEAP_NS and self._recent:
                least_ns = max(offset_ns, min(self._recent))
            self._offset_ns = leaked_ns if leaked_ns < least_ns else float(least_ns)
        self._recent.append(offset_ns)
        self._strange = 0
        self._seen_ns = host_ns
        t_ns = device_ns + round(self._offset_ns) - self._latency_ns
        return self._forward(t_ns if t_ns < host_ns else host_ns), True

    def _forward(self, t_ns: int) -> int:
        """The time, or just after that of the last sample if it is not later."""
        self._t_ns = t_ns if t_ns > self._t_ns else self._t_ns + 1
        return self._t_ns
