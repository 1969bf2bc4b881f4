"""`--json` gives one object on stdout however a command ends: its result, or the error."""

import json
from contextlib import nullcontext

import click
import pytest

from hil import bench as benches
from hil.cli import COMMANDS, main
from hil.core.errors import DeviceError

GONE = "nowhere.toml"
WRONG = {
    "list": ["planets"],
    "accept": ["--bench", GONE],
    "adhesion": ["status", "--bench", GONE],
    "calibrate": ["nowhere"],
    "calibration": ["list", GONE],
    "campaign": ["latency", "--bench", GONE],
    "commission": ["--bench", GONE],
    "console": ["--bench", GONE],
    "robot": ["show", GONE],
    "demo-data": ["data", "--bench", GONE],
    "discover": ["--port", ""],
    "doctor": ["--bench", GONE],
    "emulate": ["--bench", GONE],
    "evaluate": ["nowhere"],
    "export": [GONE],
    "faults": ["--bench", GONE],
    "info": ["--magic"],
    "jog": ["--body", "--bench", GONE],
    "live": ["--bench", GONE],
    "replay": [GONE],
    "report": [GONE],
    "results": ["list", "nowhere"],
    "run": ["latency", "--bench", GONE],
    "setup": ["--port", "/dev/no-such-port", "--id", "999"],
    "tune": ["nowhere"],
    "twin": ["compare", "nowhere"],
}


def one_object(capsys):
    said = capsys.readouterr()
    assert len(said.out.splitlines()) == 1
    assert said.err
    return json.loads(said.out)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_answers_a_mistake_with_one_object(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    code = main([command, *WRONG[command], "--json"])
    reported = one_object(capsys)["error"]
    assert set(reported) == {"message", "expected", "remedy", "exit_code", "frames"}
    assert reported["message"]
    assert reported["exit_code"] == code == 2


def test_the_parts_of_an_error_are_distinguished(capsys):
    assert main(["run", "latency", "--bench", "emulatd", "--json"]) == 2
    reported = one_object(capsys)["error"]
    assert "'emulatd'" in reported["message"]
    assert ".toml" in reported["expected"]
    assert reported["remedy"] == "did you mean emulated?"


@pytest.mark.parametrize(
    ("raised", "code"),
    [(DeviceError("imu", "gone", port="/dev/x"), 3), (KeyboardInterrupt(), 4), (click.exceptions.Abort(), 4)],
)
def test_other_ends_give_their_exit_code(monkeypatch, capsys, raised, code):
    def failing(*args, **kwargs):
        raise raised

    monkeypatch.setattr(benches, "open_emulation", failing)
    assert main(["emulate", "--json"]) == code
    assert one_object(capsys)["error"]["exit_code"] == code


def test_an_emulator_that_fails_later_adds_no_second_object(monkeypatch, capsys):
    opened = benches.open_emulation

    def fails_later(*args, **kwargs):
        server = opened(*args, **kwargs)

        def run(ready=None):
            server.close()
            raise DeviceError("imu", "gone")

        monkeypatch.setattr(server, "run", run)
        return server

    monkeypatch.setattr(benches, "open_emulation", fails_later)
    monkeypatch.setattr("signal.signal", lambda *args: None)
    monkeypatch.setattr("hil.cli.emulate._as_prompt_as_hardware", lambda priority: nullcontext())
    assert main(["emulate", "--bench", "emulated_floor", "--only", "imu", "--json"]) == 3
    assert list(one_object(capsys)) == ["imu"]
