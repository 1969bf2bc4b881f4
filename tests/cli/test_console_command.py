"""`hil console`: what it offers fits the commands; what it cannot do is said before anything is started."""

import json
import os
import signal
import socket
import subprocess
import sys

import pytest

from hil.bench import open_bench
from hil.cli import main
from hil.cli.live import open_recorder
from hil.console import forms as console_forms
from hil.console import jobs
from hil.console.json_files import read
from hil.console.stop_server import PAGE, STOP, runs
from hil.core.errors import DataError
from hil.procedure.parameters import make_parameters
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.shipped import shipped_names
from hil.support.folder_lock import locked


@pytest.fixture(scope="module")
def offered(tmp_path_factory):
    return {action.name: action for action in console_forms.actions(tmp_path_factory.mktemp("out"))}


@pytest.mark.parametrize("name", shipped_names())
def test_the_form_of_a_procedure_says_what_its_parameters_accept(offered, name):
    """Every default that is shown is accepted, and every limit that is shown is one."""
    action, proc = offered[name], load_procedure(name)
    fields = [f for f in action.fields if not f.name.startswith("--")]
    given = {f.name: f.default for f in fields if f.default}
    make_parameters(proc.parameters, given, name)
    assert action.problems(given) == {}
    assert action.problems({}) == {}
    for field in fields:
        for limit in (field.low, field.high):
            if limit is not None:
                beyond = limit - 1 if limit == field.low else limit + 1
                wrong = action.problems({field.name: str(int(beyond) if field.kind == "integer" else beyond)})
                assert list(wrong) == [field.name], field


def test_what_is_filled_in_becomes_the_words_of_the_command(offered):
    words = offered["bring_up"].words(
        {"--quick": "true", "watch_s": "3", "--fault": "imu:stuck@2 tracker:off@1"}
    )
    text = " ".join(words)
    assert text.startswith("run bring_up ")
    for part in (
        "--quick",
        "--fault=imu:stuck@2",
        "--fault=tracker:off@1",
        "--set watch_s=3",
        "--answers -",
        "--json",
    ):
        assert part in text
    assert offered["doctor"].words({"--bench": "my.toml"}) == ("doctor", "--bench=my.toml", "--json")


@pytest.mark.parametrize(
    ("name", "values", "field"),
    [
        ("bring_up", {"--seed": "-1"}, "--seed"),
        ("live", {"--duration": "0"}, "--duration"),
        ("bring_up", {"watch_s": "many"}, "watch_s"),
        ("doctor", {"--bench": "nope.toml"}, "--bench"),
        ("live", {"--bench": "emulated_floor", "--emulate": "arm"}, "--emulate"),
        ("bring_up", {"devices": "imu"}, ""),
        ("a procedure of your own", {"SCRIPT": "absent.py"}, "SCRIPT"),
    ],
)
def test_what_is_wrong_is_named_beside_its_field(offered, name, values, field):
    assert list(offered[name].problems(values)) == [field]


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_port_that_is_taken_is_named(place, capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert main(["console", "--port", str(taken.getsockname()[1])]) == 2
    err = capsys.readouterr().err
    assert "Address already in use" in err
    assert str(taken) not in err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--bench", "absent.toml"], "absent.toml"),
        (["--in", "file"], "file"),
        (["--stop", "--in", "absent"], "absent"),
        (["--stop", "--bench", "emulated"], "--bench"),
    ],
)
def test_what_it_cannot_use_is_named_and_nothing_is_started(place, capsys, words, said):
    (place / "file").write_text("mine")
    assert main(["console", *words]) == 2
    assert said in capsys.readouterr().err
    assert not list(place.rglob(STOP))


@pytest.mark.parametrize(
    ("mode", "said"),
    [(0o600, "http://127.0.0.1:41873/?token=secret"), (0o640, "kill PID"), (None, "running already")],
)
def test_a_second_console_of_the_same_folder_is_refused_and_says_how_to_get_in(place, capsys, mode, said):
    """Whoever has closed the terminal of the first has lost its address."""
    folder = place / "out" / "console"
    folder.mkdir(parents=True)
    (folder / PAGE).write_text(json.dumps(jobs.identity(os.getpid()) | {"port": 1}))
    if mode is not None:
        keys = {"port": 41873, "token": "secret", "cookie": "hil_x"}
        (folder / STOP).write_text(json.dumps(jobs.identity(os.getpid()) | keys))
        (folder / STOP).chmod(mode)
    assert main(["console"]) == 2
    err = capsys.readouterr().err
    assert said.replace("PID", str(os.getpid())) in " ".join(err.split())
    assert ("secret" in err) == (mode == 0o600)


def started(place):
    console = subprocess.Popen(
        [sys.executable, "-m", "hil", "console", "--json"], cwd=place, stdout=subprocess.PIPE, text=True
    )
    json.loads(console.stdout.readline())
    return console


def test_of_two_consoles_that_start_at_once_one_is_refused(place, capsys):
    folder = place / "out" / "console"
    folder.mkdir(parents=True)
    with locked(folder, "a console"):
        assert main(["console", "--in", str(place / "out")]) == 2
    assert "a console is at work there" in capsys.readouterr().err
    assert not (folder / STOP).exists()


def test_stop_ends_the_button_of_a_console_that_was_killed_and_of_no_other(place, capsys):
    console = started(place)
    button = read(place / "out" / "console" / STOP)
    assert main(["console", "--stop"]) == 0
    assert runs(button), "the page is there, and needs it"
    console.kill()
    console.communicate()
    assert runs(button)
    capsys.readouterr()
    assert main(["console", "--stop", "--json"]) == 0
    stopped = {"stopped": [], "last": None, "not_held": [], "button_ended": True}
    assert json.loads(capsys.readouterr().out) == stopped
    assert not runs(button)
    again = started(place)
    again.send_signal(signal.SIGINT)
    again.communicate(timeout=30)
    assert again.returncode == 0


def test_a_console_that_ends_in_order_takes_the_button_with_it(place, capsys, monkeypatch):
    """Ctrl-C at once; the process with the button sees it and ends, because nothing runs."""
    seen = []

    def ended(seconds, sleep=jobs.time.sleep):
        reported = read(place / "out" / "console" / PAGE)
        if reported and not seen:
            seen.append(reported)
            os.kill(os.getpid(), 2)
        sleep(seconds)

    monkeypatch.setattr("hil.cli.console.time.sleep", ended)
    assert main(["console", "--json"]) == 0
    out, err = capsys.readouterr()
    stop = read(place / "out" / "console" / STOP)
    assert json.loads(out)["url"] == f"http://127.0.0.1:{stop['port']}/?token={stop['token']}"
    assert seen[0]["pid"] == os.getpid()
    assert "goes on" not in err
    end_s = jobs.time.monotonic() + 30.0
    while runs(stop):
        assert jobs.time.monotonic() < end_s
        jobs.time.sleep(0.05)


def test_a_live_recording_may_go_into_a_folder_that_is_not_there_yet(place):
    """As the console asks for one."""
    with open_bench("emulated_floor") as bench:
        recorder = open_recorder(bench, place / "new" / "deeper" / "run.mcap", "stop")
        bench.observe(0.1, feedback="odometry")
    assert recorder.report()["path"] == str(place / "new" / "deeper" / "run.mcap")
    (place / "file").write_text("")
    with pytest.raises(DataError, match="cannot be created"):
        open_recorder(bench, place / "file" / "run.mcap", "stop")
