"""A fan on a CAN bus of loopback, and daemons that do not outlive their test."""

import pytest
from fan_on_the_wire import fan_on_the_wire
from kills import end_daemon


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """A running fan and its spec, for all tests of a module that leave it a daemon."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        with fan_on_the_wire() as (fan, spec):
            yield fan, spec
            end_daemon(spec)


@pytest.fixture
def wire(monkeypatch, tmp_path):
    """A running fan and its spec; its daemon at the end of the test is ended."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with fan_on_the_wire() as (fan, spec):
        yield fan, spec
        end_daemon(spec)
