"""A DBC file, read by cantools: what the frames on a CAN bus carry."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import cantools
from cantools.database import Error as CantoolsError
from cantools.database import UnsupportedDatabaseFormatError

from hil.core.errors import DataError, reason_of
from hil.support.file_reading import read_bytes

_MOST_BYTES = 4 << 20
_ENCODING = "cp1252"  # of every DBC file; cantools reads them so too


def load_database(path: Path) -> Any:
    """The `cantools.database.can.Database` of a file; the same text gives the same object.

    Raises:
        DataError: it cannot be read.
    """
    try:
        return _parsed(read_bytes(path, _MOST_BYTES).decode(_ENCODING, errors="replace"))
    except OSError as error:
        raise DataError(str(path), f"the DBC cannot be read ({reason_of(error)})") from None
    except (CantoolsError, UnsupportedDatabaseFormatError, ValueError) as error:
        raise DataError(str(path), f"not a usable DBC ({str(error).splitlines()[0]})") from None


@lru_cache(maxsize=8)
def _parsed(text: str) -> Any:
    """Parse each text once: a bench is opened many times in one process, each time with three readers."""
    return cantools.database.load_string(text, "dbc")
