"""Log messages that may come with every frame, written once a second at most, with a count."""

from __future__ import annotations

import logging

from hil.core.clock import NS_PER_S

_EVERY_NS = NS_PER_S


class Seldom:
    """One kind of warning.

    Args:
        log: where it goes.
    """

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._written_ns: int | None = None
        self._skipped = 0

    def warn(self, now_ns: int, message: str) -> None:
        """Log it, unless one was logged less than a second ago; the next one then says how often it came."""
        if self._written_ns is not None and 0 <= now_ns - self._written_ns < _EVERY_NS:
            self._skipped += 1
            return
        also = f" ({self._skipped} times more since the last message)" if self._skipped else ""
        self._log.warning("%s%s", message, also)
        self._written_ns, self._skipped = now_ns, 0
