"""Estimates how quickly a force falls, from its measurements of the last quarter of a second."""

from collections import deque

from hil.core.clock import NS_PER_S, nanoseconds

_SPAN_NS = nanoseconds(0.25)
_LEAST = 6
_LEAST_FALL_N = 0.3


class ForceTrend:
    """Time series of one force measurement."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, float]] = deque()

    def follow(self, t_ns: int, force_n: float) -> None:
        """Add a measurement, and drop those older than the time span."""
        seen = self._seen
        seen.append((t_ns, force_n))
        while seen[0][0] < t_ns - _SPAN_NS:
            seen.popleft()

    def slope_n_s(self) -> float:
        """Slope of a falling force (negative), N/s, by least squares; 0 if not falling, or too few values."""
        seen, n = self._seen, len(self._seen)
        if n < _LEAST or seen[-1][0] - seen[0][0] < _SPAN_NS // 2:
            return 0.0
        if seen[0][1] - seen[-1][1] < _LEAST_FALL_N:
            return 0.0
        t0_ns = seen[0][0]
        sum_t = sum_f = sum_tt = sum_tf = 0.0
        for t_ns, force_n in seen:
            t_s = (t_ns - t0_ns) / NS_PER_S
            sum_t += t_s
            sum_f += force_n
            sum_tt += t_s * t_s
            sum_tf += t_s * force_n
        return (n * sum_tf - sum_t * sum_f) / (n * sum_tt - sum_t * sum_t)
