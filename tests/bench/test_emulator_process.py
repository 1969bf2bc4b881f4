"""The emulator beside a bench: one that ends too early is heard."""

import sys

import pytest

from hil.bench.emulator_process import EmulatorProcess
from hil.config.loading import load_bench
from hil.core.errors import DeviceError

WORDS = "thing (hil-evil 6.6): on_due() raised RuntimeError: boom"


@pytest.fixture
def emulator(tmp_path, monkeypatch):
    """Starts something else in the emulator's place."""

    def start(script):
        program = tmp_path / "python"
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
        monkeypatch.setattr(sys, "executable", str(program))
        return EmulatorProcess(load_bench("emulated"), seed=0, faults=())

    return start


def test_one_that_ends_by_itself_leaves_its_last_words(emulator, caplog):
    running = emulator(f"echo '{{}}'; echo '{WORDS}' >&2; exit 3")
    running._child.wait(10.0)
    running.close()
    running.close()
    assert caplog.text.count(WORDS) == 1


def test_one_that_runs_until_it_is_ended_says_nothing(emulator, caplog):
    emulator("echo '{}'; read line; echo bye >&2").close()
    assert caplog.text == ""


def test_one_that_does_not_start_is_an_error_and_reported_once(emulator, caplog):
    with pytest.raises(DeviceError, match="boom"):
        emulator(f"echo '{WORDS}' >&2; exit 3")
    assert caplog.text == ""
