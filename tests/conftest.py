"""For all tests: where the public recordings are, and property tests without limits of wall-clock time."""

import errno
import os
from pathlib import Path

import pytest
from hypothesis import settings

from hil.recording import mcap_file

settings.register_profile("hil", deadline=None)
settings.load_profile("hil")
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def public_data():
    base = Path(os.environ.get("HIL_DATA", ROOT.parent / "shared" / "data"))
    folder = base / "4wis4wid"
    if not folder.is_dir():
        pytest.skip(f"public recordings not found in {folder}: set HIL_DATA (docs/calibration.md)")
    return folder


@pytest.fixture
def full_disk(monkeypatch):
    """A function that has recordings run out of disk after so many bytes."""

    def limit(capacity):
        whole = mcap_file._WholeWrites.write

        def write(file, data):
            room = capacity - file.tell()
            if len(data) <= room:
                return whole(file, data)
            whole(file, bytes(data)[: max(0, room)])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(mcap_file._WholeWrites, "write", write)

    return limit
