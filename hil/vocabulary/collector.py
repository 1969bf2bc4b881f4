"""Python's search for garbage, put off while records pile up among which there is none."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_MANY = 1_000_000
_kept = 0


@contextmanager
def without_collector() -> Iterator[None]:
    """Records hold no cycles of references: looking for garbage among them takes a fifth of the time.

    What was made meanwhile counts as old afterwards, so that nobody looks through it at once either. Python
    would never look through it then, and whoever drives many benches one after the other would keep the
    records of all: so everything is looked through whenever it has doubled.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if not gc.get_freeze_count():
            _look_through()
        if was_enabled:
            gc.enable()


def _look_through() -> None:
    global _kept
    if _made_old() > 2 * _kept + _MANY:
        gc.collect()
        _kept = _made_old()


def _made_old() -> int:
    """All objects become old; returns their number."""
    gc.freeze()
    number = gc.get_freeze_count()
    gc.unfreeze()
    return number
