"""Python's search for garbage, put off while records pile up among which there is none."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without_collector() -> Iterator[None]:
    """Records hold no cycles of references: looking for garbage among them takes a fifth of the time.

    What was made meanwhile counts as old afterwards, so that nobody looks through it at once either.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if not gc.get_freeze_count():
            gc.freeze()
            gc.unfreeze()
        if was_enabled:
            gc.enable()
