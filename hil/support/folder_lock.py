"""Locks the folder of a run, or of a series of runs, so that no second program works in it meanwhile."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from hil.core.errors import UsageError

_REMEDY = "wait for its end, or choose another --out"


@contextmanager
def locked(folder: Path, what: str, remedy: str = _REMEDY) -> Iterator[None]:
    """Lock a folder within the block, if it exists and its file system has locks.

    Args:
        folder: the folder.
        what: noun for what works there, for the error, as `a run`.
        remedy: remedy of the error.

    Raises:
        UsageError: another program has locked it.
    """
    with ExitStack() as stack:
        with suppress(OSError):
            opened = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, opened)
            try:
                fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise UsageError(f"{folder}: {what} is at work there", remedy=remedy) from None
        yield
