"""A repeated test reports its own attempt and keeps all recordings; a session that is ended closes."""

import os
import signal
import subprocess
import sys
import time

import pytest
from test_kept_failures import properties

from hil.replay.recordings import open_recording

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.usefixtures("warm_commands")

FLAKY = """
import pytest

ATTEMPTS = []

def test_flaky(bench):
    ATTEMPTS.append(bench)
    bench.observe(0.2, feedback="odometry")
    if len(ATTEMPTS) == 1:
        bench.devices.servos.release()
        bench.observe(0.3, feedback="odometry")
        pytest.fail("the first attempt")

def test_hopeless(bench):
    bench.observe(0.2, feedback="odometry")
    pytest.fail("each attempt")
"""


LONG = pytest.mark.long


@pytest.mark.parametrize("workers", [(), pytest.param(("-n", "1"), marks=LONG)])
def test_each_attempt_has_its_own_properties_and_its_own_recording(pytester, workers):
    """The passed attempt had `held = NOT HELD` and `HELD`; its start had removed the failed one's file."""
    pytest.importorskip("pytest_rerunfailures", reason="pytest-rerunfailures is not installed")
    pytester.makepyfile(test_mine=FLAKY)
    options = ("--reruns", "1", "--junitxml=junit.xml", "-p", "no:cacheprovider", "--hil-keep", "kept")
    result = pytester.runpytest_subprocess(*options, *workers)
    assert result.parseoutcomes() == {"passed": 1, "failed": 1, "rerun": 2, "warnings": 1}
    found = properties(pytester.path / "junit.xml")
    assert found["test_flaky"]["held"] == ["HELD"]
    assert found["test_flaky"]["seed"] == ["0"]
    assert not {"not_held", "recording"} & set(found["test_flaky"])
    result.stdout.fnmatch_lines(["*robots left NOT HELD*", "test_mine.py::test_flaky: NOT HELD*"])
    files = sorted(str(path.relative_to(pytester.path)) for path in pytester.path.glob("kept/*/*.mcap"))
    flaky, second, first = files
    assert "test_flaky" in flaky
    assert second == first.replace("/recording", "-2/recording")
    for file in files:
        result.stdout.fnmatch_lines([f"test_mine.py::test_*: {file}"])
        assert len(open_recording(pytester.path / file).run(0).records) > 5
    assert found["test_hopeless"]["recording"] == [second]


ENDLESS = """
import pathlib
import pytest

BENCHES = []

@pytest.fixture(autouse=True)
def witness():
    yield
    pathlib.Path("held").write_text(BENCHES[0].held.state)

def test_endless(bench):
    BENCHES.append(bench)
    bench.observe(0.3, feedback="odometry")
    pathlib.Path("begun").touch()
    while True:
        bench.observe(0.3, feedback="odometry")
"""


@pytest.mark.parametrize(
    ("name", "workers"),
    [
        ("SIGTERM", ()),
        pytest.param("SIGHUP", (), marks=LONG),
        pytest.param("SIGTERM", ("-n", "1"), marks=LONG),
    ],
    ids=str,
)
def test_a_session_that_is_ended_from_outside_leaves_the_robot_held(pytester, name, workers):
    """A CI runner that cancels a job had killed pytest: no teardown, no word on the robot, no recording."""
    pytester.makepyfile(test_mine=ENDLESS)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--hil-keep", "kept", *workers]
    session = subprocess.Popen(command, cwd=pytester.path, stdout=subprocess.PIPE, text=True)
    try:
        until = time.monotonic() + 200.0
        while not (pytester.path / "begun").exists() and session.poll() is None:
            assert time.monotonic() < until
            time.sleep(0.05)
        os.kill(session.pid, getattr(signal, name))
        said, _ = session.communicate(timeout=100)
        while workers and not (pytester.path / "held").exists():  # a worker ends after its controller
            assert time.monotonic() < until
            time.sleep(0.05)
    finally:
        session.kill()
    assert (pytester.path / "held").read_text() == "HELD"
    if not workers:
        assert session.returncode == pytest.ExitCode.INTERRUPTED
        assert f"KeyboardInterrupt: {name}" in said
        assert "test_mine.py::test_endless: HELD" in said
        (recording,) = pytester.path.glob("kept/*/recording.mcap")
        pages = [*pytester.path.glob("kept/*/recording.html")]
        assert len(pages) == 1, said
        (page,) = pages
        assert str(recording.relative_to(pytester.path)) in said
        assert str(page.relative_to(pytester.path)) in said
        assert len(open_recording(recording).run(0).records) > 5


LINELESS = """
import pathlib

def test_endless(bench):
    pathlib.Path("begun").touch()
    for _ in iter(int, 1):
        for shut in (True,):
            if shut:
                break
        else:
            shut = False
"""


@pytest.mark.parametrize("name", ["SIGTERM", pytest.param("SIGINT", marks=LONG)])
def test_a_signal_that_meets_an_instruction_without_a_line_is_reported(pytester, name):
    """What heeds signals in this loop has no line in CPython 3.11: pytest ended with a TypeError and 1."""
    pytester.makepyfile(test_mine=LINELESS)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]
    session = subprocess.Popen(command, cwd=pytester.path, stdout=subprocess.PIPE, text=True)
    try:
        until = time.monotonic() + 200.0
        while not (pytester.path / "begun").exists() and session.poll() is None:
            assert time.monotonic() < until
            time.sleep(0.05)
        os.kill(session.pid, getattr(signal, name))
        said, _ = session.communicate(timeout=100)
    finally:
        session.kill()
    assert session.returncode == pytest.ExitCode.INTERRUPTED
    assert "test_mine.py::test_endless: HELD" in said
