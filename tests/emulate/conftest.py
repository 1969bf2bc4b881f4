"""Emulators that serve the tests of a module."""

import json
from contextlib import ExitStack

import pytest
from emulators import emulator


@pytest.fixture(scope="module")
def emulate():
    """Starts emulators and returns their endpoints; all of them are ended with the module."""
    with ExitStack() as stack:
        yield lambda *options: stack.enter_context(emulator(*options)).endpoints()


@pytest.fixture(scope="module")
def served():
    """Endpoints of all devices of the shipped profile; not for longer: an emulator works without pause."""
    with emulator("--seed", "5") as running:
        yield running.endpoints()


@pytest.fixture(scope="module")
def endpoints_file(served, tmp_path_factory):
    path = tmp_path_factory.mktemp("emulate") / "endpoints.json"
    path.write_text(json.dumps(served))
    return path
