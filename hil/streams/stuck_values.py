"""Detects values that are not measured any more: real ones have noise, also at rest."""

from hil.core.clock import nanoseconds


class StuckTest:
    """Detector of readings that have been the same to the last bit for too long.

    Args:
        after_s: longest time for which they may.
    """

    def __init__(self, after_s: float) -> None:
        self._after_ns = nanoseconds(after_s)
        self.reset(0)

    def reset(self, now_ns: int) -> None:
        """Forget the last reading."""
        self._last: object = None
        self._changed_ns = now_ns

    def stuck(self, reading: object, t_ns: int) -> bool:
        """Take a reading of time `t_ns`; returns whether readings are stuck."""
        if reading != self._last:
            self._last, self._changed_ns = reading, t_ns
        return t_ns - self._changed_ns > self._after_ns
