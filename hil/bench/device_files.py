"""Puts the bench and the key that names a file into the errors of a device that cannot use the file."""

from collections.abc import Iterator
from contextlib import contextmanager

from hil.config.device import DeviceConfig
from hil.core.errors import DataError


def named_files(table: DeviceConfig) -> dict[str, str]:
    """Key -> path of the files that the table of a device names."""
    return {key: path for key in table.PATHS if (path := getattr(table, key))}


@contextmanager
def file_of_the_bench(bench: str, device: str, files: dict[str, str]) -> Iterator[None]:
    """Run code of a device; an error in a file that the bench file names says where it is named.

    Args:
        bench: name of the bench file.
        device: the device's name on the bench.
        files: paths of the device's files, by key.
    """
    try:
        yield
    except DataError as error:
        key = next((f"{device}.{key}" for key, path in files.items() if path == error.path), "")
        if not key:
            raise
        raise DataError(
            f"{bench}: {key}",
            error.message,
            expected=error.expected,
            remedy=error.remedy or f"correct that file, or name another in {key} of the bench file",
        ) from None
