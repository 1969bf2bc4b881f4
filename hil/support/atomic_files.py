"""Writes files whole (atomically); errors name the file; checks beforehand whether it can be written."""

import errno
import os
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from hil.core.errors import ConfigError, DataError, HilError, UsageError, reason_of

PARTIAL = ".hil-"
"""Prefix of incomplete files and folders; one may be left if `hil` is killed."""
_REMEDY = "choose a folder that exists and has room"
_NOT_YOURS = "choose a folder that you may write"


def check_name(path: Path, whose: str = "") -> None:
    """Make sure that a file or folder can have this name, whether it is there or not.

    Args:
        path: path of the file or folder.
        whose: origin of the name, for the error: an option, or the key of a bench file.

    Raises:
        UsageError: the name is too long for file systems, or its folder may not be searched.
    """
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError) as error:  # ValueError: a NUL character
        too_long = getattr(error, "errno", None) == errno.ENAMETOOLONG
        raise UsageError(
            f"{whose + ': ' if whose else ''}{path}: no file can be there ({reason_of(error)})",
            expected="names of at most 255 bytes, 4095 with all folders" if too_long else "",
            remedy="choose a shorter name" if too_long else "choose another place",
        ) from None


def write_text(path: Path, text: str) -> Path:
    """Write a text as UTF-8 as `replacing` does, in a folder that need not exist; returns the path.

    Raises:
        DataError: it cannot be written.
    """
    content = text.encode("utf-8", "backslashreplace")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file:
            file.write(content)
    except OSError as error:
        raise refused(path, error) from None
    return path


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Yield a file that replaces `path` atomically, with the same permissions, at the end of the block.

    If the block or the write fails, the old file remains, or none. A device, or the target of a link, is
    written in place.

    Raises:
        OSError: it cannot be written; `PermissionError` if the old file is write-protected.
    """
    if path.is_symlink() or (path.exists() and not path.is_file()):
        with path.open("wb") as file:
            yield file
        return
    partial = path.with_name(f"{PARTIAL}{secrets.token_hex(4)}")
    if path.exists() and not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    try:
        with partial.open("xb") as file:
            if path.exists():
                os.fchmod(file.fileno(), path.stat().st_mode & 0o777)
            yield file
        os.replace(partial, path)
    except BaseException:
        with suppress(OSError):
            partial.unlink()
        raise


def put_whole(path: Path, content: bytes) -> None:
    """Write a file atomically, in a folder that need not exist: a reader sees the old or the new content.

    A file beside it is written, flushed to the disk and renamed; then the folder is flushed.

    Raises:
        OSError: it cannot be written; the old file remains, and nothing beside it.
    """
    partial = path.with_name(path.name + ".part")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except BaseException:
        with suppress(OSError):
            partial.unlink()
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def make_folder(folder: Path) -> None:
    """Make a folder for results, with those above it, if it is not there.

    Raises:
        ConfigError: it is a file, or lies in one.
        OSError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise ConfigError(f"{folder}: is a file, or lies in one", remedy="choose another --out") from None


def check_folder(path: Path) -> None:
    """Make sure that files can be put into a folder, which need not exist yet; leaves nothing behind.

    Raises:
        DataError: it, or what is above it, is no folder or cannot be written.
    """
    _probe(path, path)


def check_file(path: Path) -> None:
    """Make sure that a file can be written, in a folder that need not exist yet; raises `DataError`."""
    if path.is_dir():
        raise DataError(str(path), "is a folder", expected="the name of a file")
    _probe(path, path.parent)
    if path.exists() and not os.access(path, os.W_OK):
        raise DataError(str(path), "cannot be written (Permission denied)", remedy=_NOT_YOURS)


def check_new_file(path: Path, option: str) -> None:
    """Make sure that a file can be written that is not there yet; a device, as /dev/null, may be.

    Args:
        path: path of the file.
        option: option that names it, for the error.

    Raises:
        UsageError: there is a file of that name.
        DataError: it cannot be written.
    """
    if path.is_file():
        raise UsageError(
            f"{option} {path}: exists already, and nothing is written over",
            expected="the name of a new file",
            remedy="choose another name, or remove it",
        )
    check_file(path)


def check_ending(path: Path, *endings: str) -> None:
    """Make sure that an output file has a fitting extension, so that no recording is overwritten by mistake.

    A device, as /dev/stdout, may have any name.

    Raises:
        UsageError: another ending.
    """
    if path.suffix.lower() not in endings and (path.is_file() or not path.exists()):
        raise UsageError(f"{path}: is no name for it", expected="one that ends with " + " or ".join(endings))


def _probe(path: Path, folder: Path) -> None:
    """Try to write where `folder` is or would be; `path` is what an error names."""
    try:
        there = folder
        while not there.exists() and there != there.parent:
            there = there.parent
        if not there.is_dir():
            raise DataError(str(path), f"{there} is a file", expected="a folder, new or not")
        with tempfile.TemporaryDirectory(prefix=PARTIAL, dir=there):
            pass
    except OSError as error:
        raise refused(path, error) from None


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """A folder for the files of one result, which appear in `folder` together or not at all.

    `folder` is made where it is missing, and taken away again when the body fails.

    Raises:
        DataError: something cannot be written.
    """
    check_folder(folder)
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=PARTIAL, dir=folder) as parts:
            yield Path(parts)
            for part in sorted(Path(parts).iterdir()):
                os.replace(part, folder / part.name)
    except BaseException as error:
        for path in made:
            with suppress(OSError):
                path.rmdir()
        if isinstance(error, OSError) and not isinstance(error, HilError):
            raise refused(folder, error) from None
        raise


def where_else(error: OSError) -> str:
    """Remedy for a file or folder that cannot be written."""
    return _NOT_YOURS if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS) else _REMEDY


def refused(path: Path, error: OSError) -> DataError:
    """The error of a path that cannot be written."""
    return DataError(str(path), f"cannot be written ({reason_of(error)})", remedy=where_else(error))
