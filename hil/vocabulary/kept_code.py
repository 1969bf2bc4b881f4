"""numba's store of machine code on disk: what cannot be kept or read there costs time, and ends nothing.

A disk may be full, a folder read-only, a file broken off when the computer lost its power. A kernel that is
not kept runs all the same and is compiled again by the next process; the first of them is told as a warning.
"""

from __future__ import annotations

import errno
import inspect
import logging
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba.core import config
from numba.core.caching import FunctionCache, NullCache

from hil.vocabulary.errors import HilError, reason_of

_LOG = logging.getLogger(__name__)

_BROKEN = (
    OSError,
    EOFError,
    pickle.UnpicklingError,
    ValueError,
    LookupError,
    AttributeError,
    TypeError,
    ImportError,
    MemoryError,
    OverflowError,
)
"""What reading a file that is not whole raises."""
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}

_told = ""


def store_of(function: Callable[..., Any]) -> Any:
    """Where numba is to keep the code of a function, and to look for it."""
    try:
        return _Store(function)
    except HilError:
        raise  # of a signal
    except RuntimeError:
        return _NoStore(function)


def told() -> str:
    """The warning that was given; empty before."""
    return _told


class _Store(FunctionCache):  # type: ignore[misc]
    """Files in a folder, one or more for each function."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Code for these types, if it is there and whole."""
        try:
            return super().load_overload(sig, target_context)
        except HilError:
            raise
        except _BROKEN:
            self._begin_anew()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep code for these types, if that can be done."""
        try:
            super().save_overload(sig, data)
        except HilError:
            raise
        except OSError as error:
            _tell_not_kept(self.cache_path, error)

    def _begin_anew(self) -> None:
        """Forget what is there: a list of files that cannot be read could not be added to either."""
        try:
            self.flush()
        except OSError as error:
            self.disable()
            _tell_not_kept(self.cache_path, error)


class _NoStore(NullCache):  # type: ignore[misc]
    """For a function of which no folder takes the code; one without a file (at a prompt) never has any."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._source = Path(inspect.getfile(function))

    def save_overload(self, sig: Any, data: Any) -> None:
        """Say that code is lost."""
        if self._source.exists():
            asked = [f"NUMBA_CACHE_DIR ({config.CACHE_DIR})"] if config.CACHE_DIR else []
            folders = [*asked, str(self._source.parent / "__pycache__"), "the user's cache"]
            _tell(f"cannot be kept, as {', '.join(folders[:-1])} and {folders[-1]} cannot be written", "")


def _tell_not_kept(folder: str, error: OSError) -> None:
    _tell(
        f"cannot be kept in {folder} ({reason_of(error)})",
        "make room there, or " if error.errno in _FULL else "",
    )


def _tell(what: str, remedy: str) -> None:
    """Warn, once in a process."""
    global _told
    if not _told:
        _told = (
            f"machine code {what}; it is compiled again next time: "
            f"{remedy}set NUMBA_CACHE_DIR to a folder that can be written"
        )
        _LOG.warning(_told)
