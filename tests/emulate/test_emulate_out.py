"""The file of `hil emulate --out`: whole, there when everything answers, gone before and after."""

import contextlib
import json
import os
import subprocess
import sys
import time

import pytest
import serial
from emulators import END_S, emulator

from hil.bench.endpoints_file import EndpointsFile, await_endpoints
from hil.cli import main
from hil.core.errors import DeviceTimeoutError, UsageError

pytestmark = pytest.mark.usefixtures("warm_commands")

START_S = 60.0
PINGS = {1: "fffffd0001030001194e", 8: "fffffd000803000119fa"}
STALE = json.dumps({"imu": {"port": "/dev/pts/999", "baud": 115200}})


def appears(file, process, seconds=START_S):
    """What is in the file as soon as it is there."""
    end = time.monotonic() + seconds
    while not file.exists():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < end, "the file has not appeared"
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.005)
    return json.loads(file.read_text())


def test_when_the_file_is_there_every_servo_answers_at_once(tmp_path):
    file = tmp_path / "endpoints.json"
    with emulator("--only", "servos,imu", "--out", str(file)) as running:
        where = appears(file, running.process)
        with serial.Serial(where["servos"]["port"], where["servos"]["baud"], timeout=2.0) as port:
            for servo_id, ping in PINGS.items():
                port.write(bytes.fromhex(ping))
                reported = port.read(14)
                assert len(reported) == 14, f"servo {servo_id} is silent"
                assert reported[4] == servo_id
        assert running.endpoints() == where
        assert [p.name for p in tmp_path.iterdir()] == ["endpoints.json"]
        running.process.terminate()
        assert running.process.wait(END_S) == 0
    assert list(tmp_path.iterdir()) == []


def test_the_file_waits_for_world_time_to_begin(tmp_path):
    """Before that no device answers."""
    file = tmp_path / "endpoints.json"
    with emulator("--only", "imu", "--await-start", "--out", str(file)) as running:
        running.endpoints()
        with pytest.raises(AssertionError, match="not appeared"):
            appears(file, running.process, seconds=0.5)
        running.process.stdin.write("\n")
        running.process.stdin.flush()
        assert set(appears(file, running.process)) == {"imu"}


def test_a_script_waits_for_an_emulator_and_not_for_what_one_left(tmp_path):
    """A file that a killed emulator left names ports that are not served."""
    file = tmp_path / "endpoints.json"
    file.write_text(STALE)
    waiting = subprocess.Popen(
        [sys.executable, "-m", "hil.cli", "emulate", "--wait", str(file)], stdout=subprocess.PIPE, text=True
    )
    with waiting, emulator("--only", "imu", "--out", str(file)) as running:
        reported, _ = waiting.communicate(timeout=START_S)
        assert waiting.returncode == 0
        assert json.loads(reported) == running.endpoints() != json.loads(STALE)


@pytest.mark.parametrize(("left", "why"), [(STALE, "was left behind"), (None, "has not appeared")])
def test_waiting_ends_with_what_is_missing(tmp_path, left, why):
    file = tmp_path / "endpoints.json"
    if left is not None:
        file.write_text(left)
    with pytest.raises(DeviceTimeoutError, match=why) as raised:
        await_endpoints(file, 0.0)
    assert f"hil emulate --out {file}" in raised.value.expected


@pytest.mark.parametrize("name", ["none/endpoints.json", "notes.txt"])
def test_what_no_emulator_will_write_is_not_waited_for(tmp_path, name):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="no endpoints will be there"):
        await_endpoints(tmp_path / name, 60.0)


def test_what_an_earlier_run_left_is_gone_from_the_start(tmp_path):
    file = tmp_path / "endpoints.json"
    file.write_text(STALE)
    assert main(["emulate", "--only", "imx", "--out", str(file)]) == 2
    assert not file.exists()
    file.write_text("")
    EndpointsFile(file)
    assert not file.exists()


@pytest.mark.parametrize("text", ["my notes", '{"schema": 1}'])
def test_a_file_that_is_not_endpoints_is_never_touched(tmp_path, capsys, text):
    file = tmp_path / "notes"
    file.write_text(text)
    assert main(["emulate", "--only", "imu", "--out", str(file)]) == 2
    assert file.read_text() == text
    assert "holds something else" in capsys.readouterr().err


@pytest.mark.parametrize("where", ["missing/e.json", "a" * 300])
def test_a_place_that_cannot_be_written_is_refused_before_anything_starts(tmp_path, capsys, where):
    assert main(["emulate", "--only", "imu", "--out", str(tmp_path / where)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "--out" in said.err


def test_an_emulator_takes_only_its_own_file_away(tmp_path):
    file = tmp_path / "endpoints.json"
    first = EndpointsFile(file)
    first.write('{"imu": {"port": "/dev/pts/1"}}')
    file.unlink()
    second = EndpointsFile(file)
    second.write('{"imu": {"port": "/dev/pts/2"}}')
    first.remove()
    assert "/dev/pts/2" in file.read_text()
    second.remove()
    second.remove()
    assert not file.exists()


def test_the_endpoints_of_an_emulator_that_runs_are_not_taken_over(tmp_path, capsys):
    file = tmp_path / "endpoints.json"
    late, first = EndpointsFile(file), EndpointsFile(file)
    first.write('{"imu": {"port": "/dev/pts/1"}}')
    assert main(["emulate", "--only", "imu", "--out", str(file)]) == 2
    assert f"--out {file}: an emulator that runs has its endpoints there" in capsys.readouterr().err
    with pytest.raises(UsageError, match="an emulator that runs"):
        late.write('{"imu": {"port": "/dev/pts/2"}}')
    late.remove()
    assert "/dev/pts/1" in file.read_text()
    first.remove()
    assert EndpointsFile(file)


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UsageError, match="something else"):
        EndpointsFile(tmp_path / "pipe")
