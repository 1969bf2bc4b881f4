"""Progress of work: its reports, and the estimate of the time left."""

from collections.abc import Callable
from dataclasses import dataclass

from hil.core.clock import NS_PER_S, Clock

Report = Callable[[str, int, int], None]
"""Progress: (what, done, total). `what` is `WHOLE` for the whole work, if its size is known."""

WHOLE = "in all"
_FREE_S = 1.0


def silent(what: str, done: int, total: int) -> None:
    """A report that does nothing."""


@dataclass
class Pace:
    """Time left of one piece of work, from how fast it went so far.

    What is done within the first second counts as found done (a resumed run takes it from its journal) and
    says nothing about the pace. The total may grow on the way.

    Args:
        clock: the host's; estimates are of the time that a person waits.
    """

    clock: Clock
    _begun_ns: int | None = None
    _since: tuple[int, int] | None = None
    _until_ns: int | None = None

    def update(self, done: int, total: int) -> None:
        """Take note of how far the work is."""
        now_ns = self.clock.now_ns()
        if self._begun_ns is None or (self._since is not None and done < self._since[1]):
            self._begun_ns = now_ns
        if self._since is None or now_ns - self._begun_ns < _FREE_S * NS_PER_S:
            self._since, self._until_ns = (now_ns, done), None
            return
        gained = done - self._since[1]
        if done >= total:
            self._until_ns = None
        elif gained > 0:
            self._until_ns = now_ns + (now_ns - self._since[0]) * (total - done) // gained

    @property
    def left_s(self) -> float | None:
        """Seconds left; None before anything is known, once it is done, and once the estimate has run out."""
        left_ns = -1 if self._until_ns is None else self._until_ns - self.clock.now_ns()
        return None if left_ns < 0 else left_ns / NS_PER_S


def in_words(left_s: float | None) -> str:
    """`about 40 s left`, rounded as coarsely as the estimate; empty without one."""
    if left_s is None:
        return ""
    if left_s < 5.0:
        return "a few seconds left"
    if left_s < 120.0:
        return f"about {5 * round(left_s / 5):.0f} s left"
    if left_s < 5400.0:
        return f"about {left_s / 60:.0f} min left"
    return f"about {left_s / 3600:.1f} h left"
