"""Python's search for garbage, put off while records pile up among which there is none."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_MANY = 3_000_000
_SELDOM = 10_000
_kept = 0


def seldom() -> None:
    """Look for garbage after 10,000 new objects, in a process of our own.

    After Python's own 700 the start of a process takes a tenth longer.
    """
    gc.set_threshold(_SELDOM, *gc.get_threshold()[1:])


@contextmanager
def without_collector() -> Iterator[None]:
    """Records hold no cycles of references: looking for garbage among them takes a fifth of the time.

    What was made meanwhile counts as old afterwards, so that nobody looks through it at once either. Python
    would never look through it then, and whoever drives many benches one after the other would keep the
    records of all that hang on a cycle: so where much has piled up, everything is looked through first.
    """
    was_enabled = gc.isenabled()
    _look_through()
    gc.disable()
    try:
        yield
    finally:
        if not gc.get_freeze_count():
            gc.freeze()
            gc.unfreeze()  # whatever there is has become old
        if was_enabled:
            gc.enable()


def _look_through() -> None:
    """Look for garbage when there is twice as much of everything as there was after the last time."""
    global _kept
    if sys.getallocatedblocks() > 2 * _kept + _MANY:
        gc.collect()
        _kept = sys.getallocatedblocks()
