"""A running `hil emulate`, as a third party would start it."""

import json
import subprocess
import sys

import pytest


@pytest.fixture(scope="module")
def emulator():
    """Endpoints of all emulated devices, served by another process."""
    child = subprocess.Popen(
        [sys.executable, "-m", "hil.cli", "emulate", "--seed", "5"], stdout=subprocess.PIPE, text=True
    )
    yield json.loads(child.stdout.readline())
    child.terminate()
    child.communicate(timeout=20)
    assert child.returncode == 0
