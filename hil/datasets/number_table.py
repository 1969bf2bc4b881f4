"""Reads a whole table of comma-separated numbers at once: by pyarrow if installed, else by numpy.

File readers try this first. A table with anything else they read line by line, to name the error.
"""

import warnings
from contextlib import suppress

import numpy as np

from hil.core.geometry import Array
from hil.support.extras import is_installed

_IN_NUMBERS = b"0123456789.,eE+-\nan"
"""Characters of numbers, separators, line ends and `nan`."""


def numbers_at_once(data: bytes, width: int) -> Array | None:
    """Rows (n, width) of a table with a line feed after each line; None unless all have `width` numbers."""
    if data.translate(None, _IN_NUMBERS):
        return None
    read = _by_pyarrow if is_installed("parquet") else _by_numpy
    return read(data, data.count(b"\n"), width)


def _by_pyarrow(quick: bytes, lines: int, width: int) -> Array | None:
    """Rows (lines, width); None where a row has another width, or anything but numbers.

    A pyarrow that is installed but cannot be imported, for whatever reason, counts as not installed.
    """
    try:
        import pyarrow
        from pyarrow import csv
    except Exception:
        return _by_numpy(quick, lines, width)
    names = [str(k) for k in range(width)]
    try:
        table = csv.read_csv(
            pyarrow.BufferReader(quick),
            csv.ReadOptions(use_threads=False, column_names=names, block_size=len(quick)),
            convert_options=csv.ConvertOptions(
                column_types=dict.fromkeys(names, pyarrow.float64()), null_values=[]
            ),
        )
    except pyarrow.ArrowInvalid:
        return None
    return np.column_stack([c.to_numpy() for c in table.columns]) if table.num_rows == lines else None


def _by_numpy(quick: bytes, lines: int, width: int) -> Array | None:
    """Like `_by_pyarrow`, but three times as slow."""
    marks = np.frombuffer(quick, dtype=np.uint8)
    between = marks[(marks == ord(",")) | (marks == ord("\n"))]
    if len(between) != lines * width or np.any(between[width - 1 :: width] != ord("\n")) or b",," in quick:
        return None
    with warnings.catch_warnings(), suppress(ValueError, DeprecationWarning):
        warnings.simplefilter("error", DeprecationWarning)  # how numpy reports text like 1e or 1-2
        text = quick.replace(b"\n", b",").decode("ascii")
        return np.fromstring(text, sep=",", count=lines * width).reshape(-1, width)
    return None
