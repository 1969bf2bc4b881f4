"""JSON objects that processes of the console leave for each other as files; standard library alone."""

import json
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Any

_MOST_BYTES = 1 << 24


def read(path: Path) -> dict[str, Any]:
    """A JSON object; empty where there is none."""
    with suppress(OSError, ValueError, RecursionError), path.open("rb") as file:
        tree = json.loads(file.read(_MOST_BYTES))
        return tree if isinstance(tree, dict) else {}
    return {}


def is_private(path: Path) -> bool:
    """Whether a file is this user's, and no other user can read or write it."""
    try:
        reported = path.lstat()
    except OSError:
        return False
    return stat.S_ISREG(reported.st_mode) and reported.st_uid == os.getuid() and not reported.st_mode & 0o077


def put_private(path: Path, tree: object) -> None:
    """Write a JSON file atomically, readable by its owner only; raises `OSError`."""
    partial = path.with_name(path.name + ".part")
    with suppress(FileNotFoundError):
        partial.unlink()
    descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            json.dump(tree, file)
        partial.rename(path)
    except BaseException:
        with suppress(OSError):
            partial.unlink()
        raise
