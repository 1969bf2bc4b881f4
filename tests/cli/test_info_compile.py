"""`hil info --compile` says what it could not keep and why half of it failed, and leaves no process."""

import contextlib
import io
import os
import signal
import subprocess
import sys
import time
import types
from pathlib import Path

import pytest

from hil.cli import main

KEPT_NOTHING = "machine code cannot be kept"


@pytest.fixture
def ended(monkeypatch):
    """Has nothing compiled here, and the process beside end in this way."""
    monkeypatch.setattr("hil.estimator.fusion.load_filter", lambda *_, **__: None)
    monkeypatch.setattr("hil.calibration.passes.compiled_pass", lambda: None)

    def end(code, said):
        process = types.SimpleNamespace(stdout=io.BytesIO(said.encode()), returncode=code)
        monkeypatch.setattr("hil.cli.info.beside", lambda *_, **__: contextlib.nullcontext(process))

    return end


@pytest.mark.parametrize(("told_here", "said"), [("", [KEPT_NOTHING]), (KEPT_NOTHING, [])])
def test_what_the_process_beside_could_not_keep_is_told_once(ended, monkeypatch, caplog, told_here, said):
    ended(0, KEPT_NOTHING + "\n")
    monkeypatch.setattr("hil.vocabulary.kernels.not_kept", lambda: told_here)
    assert main(["info", "--compile", "--json"]) == 0
    assert caplog.messages == said


@pytest.mark.parametrize(
    ("code", "said", "why"), [(-9, "", "a process ended with -9"), (1, "No module", "No module")]
)
def test_a_process_beside_that_fails_is_an_error(ended, capsys, code, said, why):
    ended(code, said)
    assert main(["info", "--compile"]) == 2
    assert capsys.readouterr().err == f"hil: half of the kernels is not compiled: {why}\n"


def test_without_numba_there_is_nothing_to_compile_and_it_says_so(monkeypatch, caplog):
    monkeypatch.setattr("hil.cli.info.lacks", lambda extra: "not installed")
    monkeypatch.setattr("hil.cli.info._compile", lambda: pytest.fail("there is nothing to compile"))
    assert main(["info", "--compile", "--json"]) == 0
    (said,) = caplog.messages
    assert said.startswith("nothing to compile: numba is not installed; install it with")


def below(pid):
    """Processes that a process has begun."""
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.mark.skipif(not Path(f"/proc/self/task/{os.getpid()}/children").exists(), reason="needs /proc")
def test_what_is_killed_while_it_compiles_leaves_no_process(tmp_path):
    pytest.importorskip("numba")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    with subprocess.Popen(
        [sys.executable, "-m", "hil.cli", "info", "--compile"],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        end_s = time.monotonic() + 30
        while not (others := below(process.pid)) and time.monotonic() < end_s:
            time.sleep(0.05)
        process.send_signal(signal.SIGKILL)
    assert len(others) == 1
    while left := [pid for pid in others if Path(f"/proc/{pid}/cmdline").exists()]:
        if time.monotonic() > end_s:
            os.kill(left[0], signal.SIGKILL)
            pytest.fail("the process beside lives on")
        time.sleep(0.05)
