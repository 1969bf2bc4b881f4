"""Writes small files whole, with an error that names the file."""

from __future__ import annotations

from pathlib import Path

from hil.errors import DataError


def write_text(path: Path, text: str) -> Path:
    """Write a text as UTF-8, over what was there; returns the path.

    Raises:
        DataError: it cannot be written.
    """
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DataError(
            str(path),
            f"cannot be written ({error.strerror or error})",
            remedy="choose a folder that exists and has room",
        ) from None
    return path
