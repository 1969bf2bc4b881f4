"""What the console has started: read from its files, answered, stopped, and never taken for another."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from hil.console import jobs
from hil.console.job_stopping import finish, in_words, stop_all, wait_for

ASKING = '''
"""Asks, then drives for a minute."""
from hil.procedure import procedure
from hil.robot.trajectories import line


@procedure(name="asking", needs=("servos",))
def run(ctx):
    """Ask, then drive."""
    with ctx.step("a question"):
        ctx.note("the colour is " + ctx.prompt("which colour?"))
    with ctx.step("a long drive"):
        ctx.bench.drive(line((0, 0, 0), (0.3, 0, 0), duration_s=60.0), feedback="odometry")
'''


def job_in(root, name="20260101-000000-000000", process=None, out="", err="", **changes):
    folder = root / name
    folder.mkdir(parents=True)
    reported = {"words": ["run", "x", "--json"], "title": "x", "started": 0.0, **changes}
    (folder / jobs.COMMAND).write_text(json.dumps(reported))
    (folder / jobs.PROCESS).write_text(json.dumps(process or {"pid": 1 << 22, "ticks": 1, "boot": ""}))
    (folder / jobs.STDOUT).write_text(out)
    (folder / jobs.STDERR).write_text(err)
    return jobs.jobs(root)[0]


@pytest.mark.parametrize("key", ["ticks", "boot"])
def test_a_number_that_another_process_has_now_is_never_signalled(tmp_path, key):
    stranger = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        reported = jobs.identity(stranger.pid)
        job = job_in(tmp_path, process=reported | {key: 1 if key == "ticks" else "another"})
        assert not jobs.alive(job)
        assert not jobs.send(job, signal.SIGTERM)
        assert stop_all(tmp_path) == []
        assert finish(job) == "it has ended"
        time.sleep(0.05)
        assert stranger.poll() is None
        assert jobs.same(reported)
    finally:
        stranger.communicate(b"\n")
    assert not jobs.same(reported)


@pytest.fixture
def asking(tmp_path):
    """A job that runs and asks, and what it would read on its standard input."""
    job = job_in(tmp_path, process=jobs.identity(os.getpid()))
    os.mkfifo(job.folder / jobs.STDIN)
    pipe = os.open(job.folder / jobs.STDIN, os.O_RDWR | os.O_NONBLOCK)

    def say(**reported):
        with (job.folder / jobs.STDERR).open("a") as file:
            file.write(line(**reported))
        return jobs.state(job)["question_id"]

    def got():
        try:
            return os.read(pipe, 1 << 16).decode()
        except BlockingIOError:
            return ""

    yield job, say, got
    os.close(pipe)


def test_an_answer_is_of_one_question_and_never_becomes_that_of_the_next(asking):
    """A second click comes before the job has read the first answer, or after it has asked anew."""
    job, say, got = asking
    one = say(question="is it on the stand?")
    assert jobs.answer(job, one, " on  it\nnow") == ""
    assert jobs.state(job)["question"] is None, "it does not wait any more"
    assert jobs.answer(job, one, "") == "that is not the question any more: nothing is asked any more"
    assert say(answered="on it now") is None
    two = say(question="is it on the stand?")
    assert two != one
    assert jobs.answer(job, one, "") == "that is not the question any more: read what is asked now"
    assert jobs.state(job)["question"] == "is it on the stand?"
    assert got() == "on it now\n"
    assert jobs.answer(job, two, "") == ""
    assert got() == "\n"


def test_of_two_answers_at_once_one_is_taken(asking, monkeypatch):
    """Both have seen that the question is open before either has answered it."""
    job, say, got = asking
    one = say(question="ready?")
    seen = jobs.state(job)
    monkeypatch.setattr(jobs, "state", lambda job: seen)
    assert [jobs.answer(job, one, "a"), jobs.answer(job, one, "b")] == [
        "",
        "another user has just answered that question",
    ]
    assert got() == "a\n"


def test_a_question_keeps_its_identity_while_more_is_said_than_is_read(asking):
    job, say, _ = asking
    more = line(progress={"what": "x" * 100, "done": 1, "total": 2, "left_s": None}) * 2000
    with (job.folder / jobs.STDERR).open("a") as file:
        file.write(more)
    before = say(question="ready?")
    assert say(progress={"what": "x", "done": 1, "total": 2, "left_s": None}) == before
    with (job.folder / jobs.STDERR).open("rb") as file:
        file.seek(before)
        assert json.loads(file.readline()) == {"question": "ready?"}


def test_an_answer_that_a_pipe_would_cut_is_refused_and_the_question_stays(asking):
    job, say, got = asking
    one = say(question="ready?")
    assert jobs.answer(job, one, "ä" * 3000) == "an answer has less than 4096 bytes"
    assert jobs.answer(job, one, "\ud800") == ""
    assert got() == "?\n"


def test_what_was_asked_when_stop_was_pressed_takes_no_answer_that_could_move_the_robot(asking, monkeypatch):
    job, say, got = asking
    one = say(question="ready?")
    monkeypatch.setattr(jobs, "_STOPPING_S", 3600.0)
    (job.folder / jobs.STOPPED).write_text(json.dumps({"when": time.time()}))
    assert jobs.answer(job, one, "") == "x is being stopped: nothing is answered"
    assert got() == ""
    (job.folder / jobs.STOPPED).write_text(json.dumps({"when": time.time() - 7200.0}))
    assert jobs.answer(job, one, "") == "", "what the way out asks"


def test_a_job_that_cannot_read_has_not_been_answered(asking):
    job, say, _ = asking
    one = say(question="ready?")
    (job.folder / jobs.STDIN).unlink()
    assert jobs.answer(job, one, "") == "x has ended"
    assert jobs.state(job)["question"] == "ready?"


def test_a_second_click_on_the_end_after_a_step_does_not_end_it_at_once(asking, monkeypatch):
    job, _, _ = asking
    sent = []
    monkeypatch.setattr("hil.console.job_stopping.send", lambda job, number: sent.append(number) or True)
    assert finish(job) == ""
    assert jobs.state(job)["finishing"]
    assert finish(job) == "it was asked to end already: STOP ends it at once"
    assert sent == [signal.SIGINT]


def line(**reported):
    return json.dumps(reported) + "\n"


def test_what_a_running_job_says_is_its_state(tmp_path):
    said = (
        "a message\n"
        + line(progress={"what": "in all", "done": 1, "total": 9, "left_s": 4.0})
        + line(progress={"what": "a step", "done": 2, "total": 5, "left_s": None})
        + line(question="old?")
        + line(answered="yes")
        + line(live={"pose": [1, 2, 3], "events": ["imu: stuck"]})
        + line(question="ready?")
        + '{"live": {"po'
    )
    state = jobs.state(job_in(tmp_path, process=jobs.identity(os.getpid()), err=said))
    assert state["running"]
    assert (state["whole"]["done"], state["progress"]["done"]) == (1, 2)
    assert state["question"] == "ready?"
    assert (state["live"]["pose"], state["events"]) == ([1, 2, 3], ["imu: stuck"])
    assert state["messages"][0] == "a message"


def test_figures_have_an_age_and_what_is_watched_ends_with_the_next_loop(tmp_path):
    told = line(live={"pose": [1, 2, 3], "host_s": time.monotonic() - 7.0, "events": []})
    process, watched = jobs.identity(os.getpid()), {"words": "the loop has stopped: no air", "events": ["e"]}
    state = jobs.state(job_in(tmp_path / "a", process=process, err=told + line(watched=watched)))
    assert (state["watched"], state["events"]) == (watched, ["e"])
    assert 7.0 <= state["live_age_s"] < 60.0
    state = jobs.state(job_in(tmp_path / "b", process=process, err=line(watched=watched) + told))
    assert state["watched"] is None


@pytest.mark.parametrize("text", ["null", "{}", '{"progress": 1}', '{"live": [], "b": 1}', "{"])
def test_a_line_that_is_no_object_of_ours_is_a_message(tmp_path, text):
    state = jobs.state(job_in(tmp_path, process=jobs.identity(os.getpid()), err=text + "\n"))
    assert state["messages"] == [text]


HELD = {"state": "HELD", "moved_m": 0.0, "why": "at rest"}


@pytest.mark.parametrize(
    ("out", "err", "verdict", "words"),
    [
        ({"verdict": "PASS", "error": None, "held": HELD}, "", "PASS", "x: HELD: at rest"),
        ({"verdict": "ABORTED", "error": {"message": "."}, "held": HELD}, "", "ABORTED", "x: HELD: at rest"),
        ({"ended": "SIGINT", "held": HELD | {"state": "NOT HELD"}}, "", "ABORTED", "x: NOT HELD: at rest"),
        ({"ended": "duration", "held": HELD}, "", "DONE", "x: HELD: at rest"),
        ({"ended": "key x", "held": HELD}, "", "DONE", "x: HELD: at rest"),
        ({"ended": "robot stopped (stale)", "held": HELD}, "", "ERROR", "x: HELD: at rest"),
        ({"ok": False, "findings": []}, "", "FAIL", "x: FAIL"),
        ({"error": {"message": "no port", "remedy": "plug it in", "exit_code": 3}}, "", "ERROR", "x: ERROR"),
        ({"error": {"message": "no", "exit_code": 4}}, line(held=HELD), "ABORTED", "x: HELD: at rest"),
        (
            None,
            "",
            "ENDED",
            "x: it ended without a result: it was killed, or could not start; "
            "check whether the robot is held",
        ),
    ],
)
def test_how_a_job_ended_is_in_what_it_wrote_last(tmp_path, out, err, verdict, words):
    job = job_in(tmp_path, out="" if out is None else json.dumps(out), err=err)
    state = jobs.state(job)
    assert not state["running"]
    assert state["verdict"] == verdict
    assert in_words(state) == words


@pytest.mark.parametrize(
    ("mark", "out", "verdict"),
    [
        (jobs.STOPPED, {"ended": "SIGINT", "held": HELD}, "STOPPED"),
        (jobs.STOPPED, {"verdict": "ABORTED", "error": {"message": "."}, "held": HELD}, "STOPPED"),
        (jobs.STOPPED, {"verdict": "PASS", "error": None, "held": HELD}, "PASS"),
        (jobs.FINISH, {"ended": "SIGINT", "held": HELD}, "DONE"),
        (jobs.FINISH, {"verdict": "ABORTED", "error": {"message": "."}, "held": HELD}, "ABORTED"),
    ],
)
def test_what_a_person_has_stopped_is_shown_as_stopped_and_not_as_a_signal(tmp_path, mark, out, verdict):
    job = job_in(tmp_path, out=json.dumps(out))
    (job.folder / mark).write_text("{}")
    state = jobs.state(job)
    assert state["verdict"] == verdict
    assert "SIG" not in state["why"]


def test_the_latest_job_is_the_first_also_as_summer_time_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(jobs, "detached", lambda *_: None)
    try:
        for zone in ("SUMMER-2", "WINTER-1"):
            monkeypatch.setenv("TZ", zone)
            time.tzset()
            jobs.start(tmp_path, ["info"], zone)
    finally:
        monkeypatch.undo()
        time.tzset()
    assert [job.title for job in jobs.jobs(tmp_path)] == ["WINTER-1", "SUMMER-2"]


def test_folders_that_are_no_jobs_are_left_out(tmp_path):
    job_in(tmp_path)
    for name, text in (("a", "{"), ("b", '{"words": 1, "title": "x", "started": 0}'), ("c", "[]")):
        (tmp_path / name).mkdir()
        (tmp_path / name / jobs.COMMAND).write_text(text)
    assert [job.name for job in jobs.jobs(tmp_path)] == ["20260101-000000-000000"]
    assert jobs.jobs(tmp_path / "absent") == []


def test_a_job_that_was_stopped_before_its_process_was_known_does_not_begin(tmp_path):
    job = job_in(tmp_path, process={"pid": 0}, started=time.time())
    (job.folder / jobs.PROCESS).unlink()
    assert stop_all(tmp_path) == [job]
    done = subprocess.run(
        [sys.executable, "-m", "hil.console.job_process", str(job.folder)], capture_output=True
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    assert (job.folder / jobs.STDOUT).read_text() == ""


def wait_until(condition, limit_s=60.0):
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def test_a_job_of_a_console_that_ignores_ctrl_c_ends_after_its_step_all_the_same(tmp_path):
    """A script that starts the console with `&` makes it ignore SIGINT, and children inherit that."""
    (tmp_path / "asking.py").write_text(ASKING)
    words = ["run", str(tmp_path / "asking.py"), "--answers=-", "--json", "--out", str(tmp_path / "out")]
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        job = jobs.start(tmp_path / "jobs", words, "asking")
    finally:
        signal.signal(signal.SIGINT, before)
    try:
        wait_until(lambda: jobs.state(job)["question"] == "which colour?")
        assert finish(job) == ""
        assert jobs.answer(job, jobs.state(job)["question_id"], "blue") == ""
        wait_until(lambda: not jobs.alive(job))
    finally:
        stop_all(tmp_path / "jobs")
    steps = json.loads((tmp_path / "out" / "result.json").read_text())["steps"]
    assert [step["title"] for step in steps] == ["a question"]


def test_a_request_that_a_process_ignores_is_refused_and_can_be_made_again(tmp_path):
    code = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); print(flush=True); input()"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", code], **pipes) as deaf:
        deaf.stdout.readline()
        job = job_in(tmp_path, process=jobs.identity(deaf.pid))
        for _ in range(2):
            assert "STOP ends it" in finish(job)
            assert not jobs.state(job)["finishing"]
        deaf.communicate(b"\n")


def test_a_run_is_asked_for_answered_and_stopped_within_its_step_and_ends_held(tmp_path):
    """By its files alone: nothing of the process that started it is needed."""
    (tmp_path / "asking.py").write_text(ASKING)
    words = ["run", str(tmp_path / "asking.py"), "--answers=-", "--json", "--out", str(tmp_path / "out")]
    jobs.start(tmp_path / "jobs", words, "asking")
    (job,) = jobs.jobs(tmp_path / "jobs")
    try:
        wait_until(lambda: jobs.state(job)["question"] == "which colour?")
        assert jobs.answer(job, jobs.state(job)["question_id"], "blue\nand green") == ""
        wait_until(lambda: (jobs.state(job)["progress"] or {}).get("what") == "a long drive")
        wait_until(lambda: jobs.state(job)["live"])
    finally:
        asked = stop_all(tmp_path / "jobs")
    assert asked == [job]
    (state,) = wait_for(asked, 60.0)
    assert (state["verdict"], state["held"]["state"]) == ("STOPPED", "HELD")
    notes = json.loads((tmp_path / "out" / "result.json").read_text())["notes"]
    assert "the colour is blue and green" in notes
    assert jobs.answer(job, 0, "more") == "that is not the question any more: nothing is asked any more"
