"""Where the public recordings are."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def public_data():
    base = Path(os.environ.get("HIL_DATA", ROOT.parent / "shared" / "data"))
    folder = base / "4wis4wid"
    if not folder.is_dir():
        pytest.skip(f"public recordings not found in {folder}: set HIL_DATA (README, section Data)")
    return folder
