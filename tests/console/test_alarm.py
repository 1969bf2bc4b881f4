"""The alarm of a robot that was left NOT HELD: what keeps it, what takes it away, what a terminal says."""

import json
import os
from datetime import datetime

import pytest

from hil.cli import main
from hil.console import jobs
from hil.console.not_held_alarm import SECURED, Alarm
from hil.console.stop_server import StopProcess
from hil.console.web_server import Refused, Request
from tests.console.test_jobs import HELD, job_in, line

LOOSE = HELD | {"state": "NOT HELD", "why": "the fan does not answer"}
UNTOUCHED = {"state": "not needed", "moved_m": None, "why": "no device was opened"}
ON_THE_FLOOR = {"state": "not needed", "moved_m": 0.0, "why": "on the floor; torque on, at rest by wheels"}
MINE = ["run", "x", "--bench=my.toml", "--json"]


def names(n):
    return f"20260101-00000{n}-000000"


def left(folder, n, held, words=MINE, **reported):
    """The nth job, which ended so."""
    out = "" if held is None else json.dumps({"verdict": "PASS", "held": held, **reported})
    return job_in(folder / "jobs", names(n), out=out, words=words)


def examined(folder, n):
    out = json.dumps({"ok": True, "findings": []})
    return job_in(folder / "jobs", names(n), out=out, words=["doctor", "--bench=my.toml", "--json"])


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "out" / "console"
    left(place, 1, LOOSE)
    return place


@pytest.mark.parametrize(
    "later",
    [
        examined,
        lambda place, n: left(place, n, UNTOUCHED),
        lambda place, n: left(place, n, None),
        lambda place, n: left(place, n, HELD, words=["run", "x", "--json"]),
        lambda place, n: left(place, n, HELD, words=["run", "x", "--bench=other.toml", "--json"]),
        lambda place, n: left(place, n, HELD, words=[*MINE, "--emulate=all"]),
        lambda place, n: job_in(
            place / "jobs", names(n), process=jobs.identity(os.getpid()), words=MINE, err=line(held=HELD)
        ),
    ],
    ids=["examined", "untouched", "no result", "another world", "another bench", "emulated", "still runs"],
)
def test_a_job_that_has_not_looked_at_that_robot_does_not_clear_it(folder, later):
    alarm = Alarm(folder)
    before = alarm.not_held()
    later(folder, 2)
    assert alarm.not_held() == Alarm(folder).not_held() == before


@pytest.mark.parametrize("held", [HELD, ON_THE_FLOOR])
def test_a_run_that_found_it_held_takes_it_away_and_the_next_one_may_bring_it_back(folder, held):
    alarm = Alarm(folder)
    left(folder, 2, held)
    assert alarm.not_held() == []
    left(folder, 3, LOOSE | {"why": "again"})
    assert [reported["job"] for reported in alarm.not_held()] == [names(3)]


def test_a_job_that_was_looked_at_before_its_process_was_there_is_heard_all_the_same(tmp_path):
    """The page asks every second, and may do so while a job is being started."""
    job = left(tmp_path, 1, None)
    process = (job.folder / jobs.PROCESS).rename(tmp_path / "later")
    alarm = Alarm(tmp_path)
    assert alarm.not_held() == []
    process.rename(job.folder / jobs.PROCESS)
    (job.folder / jobs.STDOUT).write_text(json.dumps({"verdict": "FAIL", "held": LOOSE}))
    assert [reported["job"] for reported in alarm.not_held()] == [job.name]


def test_it_is_kept_however_much_was_started_since(folder):
    for n in range(300):
        job_in(folder / "jobs", f"20260102-000000-{n:06}", out='{"ok": true}')
    assert [reported["job"] for reported in Alarm(folder).not_held()] == [names(1)]


def test_a_run_that_was_killed_while_it_drove_is_one_too_and_doctor_that_was_killed_is_none(tmp_path):
    moved = line(held=HELD) + line(live={"pose": [0, 0, 0]})
    job_in(tmp_path / "jobs", names(1), words=MINE, err=moved)
    job_in(tmp_path / "jobs", names(2), words=["doctor", "--bench=my.toml"])
    (reported,) = Alarm(tmp_path).not_held()
    assert "x was killed while its loop ran" in reported["words"]


@pytest.mark.parametrize("robot", ["real", "emulated", None])
def test_it_says_which_bench_when_and_whether_a_robot_must_be_secured(tmp_path, robot):
    """A mix may have emulated servos although a file is named; without figures, what the result says."""
    seen = line(live={"bench": "lab", "robot": robot}) if robot else ""
    out = json.dumps({"verdict": "FAIL", "held": LOOSE, "emulated": [] if robot else ["servos"]})
    job = job_in(tmp_path / "jobs", names(1), out=out, err=seen, words=MINE)
    ended = datetime(2026, 1, 2, 3, 4, 5).timestamp()
    os.utime(job.folder / jobs.STDOUT, (ended, ended))
    os.utime(job.folder / jobs.STDERR, (ended - 9.0, ended - 9.0))
    (reported,) = Alarm(tmp_path).not_held()
    said = reported["words"]
    assert "my.toml" in said
    assert ("lab" in said) is (robot is not None)
    assert "2026-01-02 03:04:05" in said
    assert ("Secure it" in said) is said.startswith("Real") is (robot == "real")


def asked(process, method, path, body=None):
    return json.loads(process.routes()[method, path](Request(path, {}, body or {}, "127.0.0.1")).content)


def test_a_person_takes_away_what_the_page_shows_and_it_stays_away_after_a_restart(folder):
    process = StopProcess(folder)
    (shown,) = asked(process, "GET", "/state")["not_held"]
    other = left(folder, 2, LOOSE, words=["run", "x", "--bench=other.toml"])  # since the page was drawn
    assert asked(process, "POST", "/secured", {"jobs": [shown["job"], "../x"]}) == {}
    for later in (process, StopProcess(folder)):
        assert [reported["job"] for reported in asked(later, "GET", "/state")["not_held"]] == [other.name]
    left(folder, 3, LOOSE)
    assert len(asked(process, "GET", "/state")["not_held"]) == 2


def test_what_cannot_be_noted_is_not_taken_away(folder):
    (folder / f"{SECURED}.part").mkdir()
    process = StopProcess(folder)
    with pytest.raises(Refused, match="the alarm stays"):
        asked(process, "POST", "/secured", {"jobs": [names(1)]})
    with pytest.raises(Refused, match="names of jobs"):
        asked(process, "POST", "/secured", {"jobs": names(1)})
    assert len(asked(process, "GET", "/state")["not_held"]) == 1


def test_a_terminal_learns_it_with_exit_code_3_until_it_is_secured(folder, capsys):
    def stop(*words):
        code = main(["console", "--in", str(folder.parent), "--stop", *words])
        return code, capsys.readouterr().out

    code, said = stop()
    assert code == 3
    assert "nothing runs" in said
    assert "the last was x: NOT HELD: the fan does not answer" in said
    assert "NOT HELD after x: the fan does not answer" in said
    assert "Real robot, bench my.toml" in said
    examined(folder, 2)
    code, said = stop("--json")
    assert (code, json.loads(said)["last"]["title"], len(json.loads(said)["not_held"])) == (3, "x", 1)
    Alarm(folder).secure([names(1)])
    code, said = stop()
    assert code == 0
    assert "Real robot" not in said
