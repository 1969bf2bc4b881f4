"""For all tests: where the public recordings are, and property tests without limits of wall-clock time."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("hil", deadline=None)
settings.load_profile("hil")
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def public_data():
    base = Path(os.environ.get("HIL_DATA", ROOT.parent / "shared" / "data"))
    folder = base / "4wis4wid"
    if not folder.is_dir():
        pytest.skip(f"public recordings not found in {folder}: set HIL_DATA (README, section Data)")
    return folder
