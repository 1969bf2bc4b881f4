"""Source distributions of peers, fetched by pip when a test asks, in the version that is installed."""

import subprocess
import sys
import tarfile
from importlib.metadata import version

import pytest


def source_of(package, folder):
    """Folder of a package's unpacked source; skips where no package index can be reached."""
    wanted = f"{package}=={version(package)}"
    reported = subprocess.run(
        [
            sys.executable,
            "-m",
            "pip",
            "download",
            "--no-deps",
            "--no-binary",
            ":all:",
            "--disable-pip-version-check",
            "--dest",
            folder,
            wanted,
        ],
        capture_output=True,
        text=True,
        timeout=240,
    )
    archives = list(folder.glob("*.tar.gz"))
    if reported.returncode or not archives:
        pytest.skip(f"the source distribution of {wanted} cannot be had: {reported.stderr.strip()[-200:]}")
    with tarfile.open(archives[0]) as archive:
        if hasattr(tarfile, "data_filter"):
            archive.extractall(folder, filter="data")
        else:
            archive.extractall(folder)
    return next(path for path in folder.iterdir() if path.is_dir())
