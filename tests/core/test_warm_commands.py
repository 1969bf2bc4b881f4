"""Commands that are forked are processes as those that are started, and say the same."""

import json
import os
import signal
import subprocess
import sys

import pytest

from tests import warm

pytestmark = [
    pytest.mark.usefixtures("warm_commands"),
    pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="commands are forked on Linux only"),
]

HIL = (sys.executable, "-m", "hil.cli")
EMULATOR = (*HIL, "emulate", "--only", "imu")
END_S = 60.0


def told(start, *words, folder):
    process = start([*HIL, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder)
    out, errors = process.communicate(timeout=END_S)
    return process, (process.returncode, out, errors)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0, ["list", "faults"]),
        (0, ["run", "steering_zero", "--dry-run"]),
        (2, ["lst"]),
        (2, ["run", "mine.py", "--json"]),
        (3, ["doctor", "--bench", "emulated_floor", "--fault", "imu:off", "--json"]),
    ],
)
def test_a_forked_command_says_what_a_started_one_says(tmp_path, code, words):
    (tmp_path / "mine.py").write_text("import os\nraise RuntimeError(os.getcwd())\n")
    forked, said = told(subprocess.Popen, *words, folder=tmp_path)
    assert forked.forked
    assert said == told(warm.STARTED, *words, folder=tmp_path)[1]
    assert said[0] == code


def test_folder_environment_and_session_are_its_own(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import os, sys\nraise RuntimeError(repr((os.getcwd(), os.environ['ONLY_HERE'], "
        "'HOME' in os.environ, os.getsid(0) == os.getpid(), sys.argv[1:], sys.path[0])))\n"
    )
    kept = {name: value for name, value in os.environ.items() if name != "HOME"}
    done = subprocess.run(
        [*HIL, "run", "mine.py"],
        cwd=tmp_path,
        env={**kept, "ONLY_HERE": "yes"},
        capture_output=True,
        text=True,
        start_new_session=True,
        timeout=END_S,
    )
    here = str(tmp_path)
    assert repr((here, "yes", False, True, ["run", "mine.py"], here)) in done.stderr
    assert "ONLY_HERE" not in os.environ
    assert os.getcwd() != here


@pytest.mark.parametrize(("number", "code"), [("SIGTERM", 0), ("SIGINT", 0), ("SIGKILL", -signal.SIGKILL)])
def test_signals_reach_it_and_their_end_is_told(number, code):
    with subprocess.Popen(EMULATOR, stdout=subprocess.PIPE, text=True) as process:
        assert process.forked
        assert "imu" in json.loads(process.stdout.readline())
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.05)
        assert process.poll() is None
        os.kill(process.pid, getattr(signal, number))
        assert process.wait(END_S) == code
    assert process.poll() == code
    with pytest.raises(ProcessLookupError):
        os.kill(process.pid, 0)


def test_it_reads_its_standard_input_and_two_run_side_by_side():
    start = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    both = [subprocess.Popen((*EMULATOR, "--lifeline"), **start) for _ in range(2)]
    ports = {json.loads(process.stdout.readline())["imu"]["port"] for process in both}
    assert len(ports) == len({process.pid for process in both}) == 2
    for process in both:
        process.stdin.close()
        assert process.wait(END_S) == 0
        process.stdout.close()


def test_pytest_is_forked_with_the_folder_of_its_tests(tmp_path):
    (tmp_path / "beside.py").write_text("HERE = 1\n")
    (tmp_path / "test_mine.py").write_text("from beside import HERE\ndef test_it():\n    assert HERE == 2\n")
    path = os.pathsep.join((str(tmp_path), os.environ.get("PYTHONPATH", ""))).strip(os.pathsep)
    with subprocess.Popen(
        [sys.executable, "-mpytest", "-q", "-p", "no:cacheprovider"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": path},
        text=True,
    ) as process:
        said, _ = process.communicate(timeout=END_S)
    assert process.forked
    assert process.returncode == 1
    assert "assert 1 == 2" in said


@pytest.mark.parametrize(
    "how",
    [
        {"args": [sys.executable, "-c", ""]},
        {"args": [sys.executable, "-m", "hil.drivers.adhesion.keeper"]},
        {"env": {**os.environ, "PYTHONPATH": "/elsewhere"}},
        {"env": {**os.environ, "NUMBA_DISABLE_JIT": "1"}},
        {"preexec_fn": os.getpid},
        {"close_fds": False},
    ],
)
def test_what_would_come_out_otherwise_is_started(how):
    nowhere = subprocess.DEVNULL
    with subprocess.Popen(**{"args": [*HIL, "--version"], **how}, stdout=nowhere, stderr=nowhere) as process:
        assert not process.forked
        process.wait(END_S)
