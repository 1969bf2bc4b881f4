"""Python's search for garbage, while many objects exist that are not garbage."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def old_objects_passed_over() -> Iterator[None]:
    """Leave all objects that exist now out of the search, which else looks at each of them again and again.

    Does nothing where some are left out already.
    """
    if gc.get_freeze_count():
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
