"""A fan on a CAN bus of loopback, and keepers that do not outlive their test."""

import os
import signal
from contextlib import suppress

import pytest
from fan_on_the_wire import fan_on_the_wire

from hil.drivers.adhesion.keeper import client


@pytest.fixture
def wire(monkeypatch, tmp_path):
    """A running fan and its spec; whoever keeps it at the end of the test is ended."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with fan_on_the_wire() as (fan, spec):
        yield fan, spec
        end_keeper(spec)


def end_keeper(spec):
    """End the keeper of a test's fan the only way there is."""
    connection = client.connect(spec)
    if connection is not None:
        with connection, suppress(ProcessLookupError):
            pid = client.peer(connection)[0]
            assert pid != os.getpid()
            os.kill(pid, signal.SIGKILL)
