"""The page: what it lists, what it refuses to show, and that it starts one thing at a time."""

import json
import os
from http import HTTPStatus

import numpy as np
import pytest

from hil.console import jobs
from hil.console.command_forms import Action, Field
from hil.console.forms import actions
from hil.console.held_buttons import KEYS
from hil.console.page_server import PageProcess
from hil.console.web_server import Refused, Request
from hil.core.clock import nanoseconds
from hil.live.held_keys import LET_GO_S, HeldKeys
from tests.console.test_jobs import job_in


def words(values):
    return ("info", *(f"{k}={v}" for k, v in values.items()))


def problems(values):
    return {"seed": "no number"} if values.get("seed") == "x" else {}


ACTION = Action("idle", "procedures", "Does nothing.", (Field("seed", "Seed", "integer"),), words, problems)


@pytest.fixture
def page(tmp_path, monkeypatch):
    monkeypatch.setattr(jobs, "detached", lambda module, folder: None)
    results = tmp_path / "out"
    (results / "console").mkdir(parents=True)
    process = PageProcess(results / "console", results, lambda: [ACTION], lambda: ["emulated"], None)

    def ask(method, path, body=None, **query):
        routes = process.routes()
        above = next((place for place in ("/pages/", "/results/") if path.startswith(place)), path)
        route = routes[method, above]
        return route(Request(path, query, body or {}, "127.0.0.1"))

    ask.results = results
    return ask


def tree(reply):
    return json.loads(reply.content)


def test_what_is_wrong_stands_by_its_field_and_nothing_is_started(page):
    reported = tree(page("POST", "/api/start", {"action": "idle", "values": {"seed": "x"}}))
    assert reported == {"problems": {"seed": "no number"}}
    reported = tree(page("POST", "/api/start", {"action": "idle", "values": {"seed": "3", "sead": "4"}}))
    assert reported == {"problems": {"sead": "there is no such field"}}
    assert jobs.jobs(page.results / "console" / "jobs") == []


@pytest.mark.parametrize(
    "body", [{}, {"action": "idle"}, {"action": "rm", "values": {}}, {"action": "idle", "values": 1}]
)
def test_what_is_not_offered_is_not_started(page, body):
    with pytest.raises(Refused) as refused:
        page("POST", "/api/start", body)
    assert refused.value.status == HTTPStatus.BAD_REQUEST


def test_one_thing_at_a_time(page):
    asked = {"action": "idle", "values": {"seed": " 3 ", "other": ""}}
    name = tree(page("POST", "/api/start", asked))["job"]
    (job,) = jobs.jobs(page.results / "console" / "jobs")
    assert (job.name, job.words) == (name, ("info", "seed=3"))
    with pytest.raises(Refused, match="idle is still running"):
        page("POST", "/api/start", asked)
    (job.folder / jobs.PROCESS).write_text(json.dumps({"pid": 1 << 22, "ticks": 1, "boot": ""}))  # has ended
    page("POST", "/api/start", asked)


def test_only_a_question_that_is_open_is_answered(page):
    name = tree(page("POST", "/api/start", {"action": "idle", "values": {}}))["job"]
    for body, status, said in (
        ({"job": name, "question_id": 0, "text": "yes"}, HTTPStatus.CONFLICT, "nothing is asked"),
        ({"job": "../x", "question_id": 0, "text": "yes"}, HTTPStatus.NOT_FOUND, "no such run"),
    ):
        with pytest.raises(Refused, match=said) as refused:
            page("POST", "/api/answer", body)
        assert refused.value.status == status


def test_an_answer_without_its_question_or_its_text_is_refused(page):
    asks = page.results / "console" / "jobs"
    job = job_in(asks, process=jobs.identity(os.getpid()), err=json.dumps({"question": "ready?"}) + "\n")
    (reported,) = tree(page("GET", "/api/state"))["jobs"]
    assert (reported["question"], reported["question_id"]) == ("ready?", 0)
    for body in (
        {"text": ""},
        {"question_id": None, "text": ""},
        {"question_id": "0", "text": ""},
        {"question_id": False, "text": ""},
        {"question_id": 0},
    ):
        with pytest.raises(Refused, match="expected the question_id") as refused:
            page("POST", "/api/answer", {"job": job.name, **body})
        assert refused.value.status == HTTPStatus.BAD_REQUEST


def test_what_runs_and_how_it_ended_is_reported_with_its_page(page):
    tree(page("POST", "/api/start", {"action": "idle", "values": {}}))
    (job,) = jobs.jobs(page.results / "console" / "jobs")
    (job.folder / jobs.PROCESS).write_text(json.dumps(jobs.identity(os.getpid())))
    assert tree(page("GET", "/api/state"))["jobs"][0]["running"]
    (job.folder / jobs.PROCESS).write_text(json.dumps({"pid": 1 << 22, "ticks": 1, "boot": ""}))
    report = page.results / "idle run" / "report.html"
    (job.folder / jobs.STDOUT).write_text(
        json.dumps({"verdict": "PASS", "report": str(report), "error": None})
    )
    (reported,) = tree(page("GET", "/api/state"))["jobs"]
    assert (reported["verdict"], reported["link"]) == ("PASS", "/pages/idle%20run/report.html")


def test_the_history_names_a_foreign_page_as_what_it_is_and_does_not_lead_there(page):
    (page.results / "notes").mkdir()
    (page.results / "notes" / "mine.html").write_text("<title>My notes</title>")
    (reported,) = tree(page("GET", "/api/results"))["results"]
    assert (reported["kind"], reported["procedure"], reported["link"]) == ("foreign", "My notes", None)
    assert "mine.html" in reported["why"]
    assert tree(page("GET", "/api/results", words="absent"))["found"] == 0


def test_a_page_of_results_is_shown_without_the_rights_of_the_console(page):
    (page.results / "run").mkdir()
    (page.results / "run" / "report.html").write_text("<script>steal()</script>")
    reply = page("GET", "/pages/run/report.html")
    assert reply.content == b"<script>steal()</script>"
    sandbox = reply.headers["Content-Security-Policy"].split()
    assert sandbox[0] == "sandbox"
    assert "allow-same-origin" not in sandbox
    assert "default-src 'none';" in reply.headers["Content-Security-Policy"]


@pytest.mark.parametrize(
    "name",
    [
        "../secret.txt",
        "/etc/hostname",
        "link.txt",
        "linked/secret.txt",
        "console/stop.json",
        ".hidden.txt",
        "run",
        "",
        "run/tool.py",
        "nul\0l.html",
        "x" * 5000,
    ],
)
def test_nothing_else_of_this_computer_is_shown(page, tmp_path, name):
    (tmp_path / "secret.txt").write_text("secret")
    (page.results / "run").mkdir()
    for path in (
        page.results / "run" / "tool.py",
        page.results / ".hidden.txt",
        page.results / "console" / "stop.json",
    ):
        path.write_text("secret")
    (page.results / "link.txt").symlink_to(tmp_path / "secret.txt")
    (page.results / "linked").symlink_to(tmp_path)
    with pytest.raises(Refused) as refused:
        page("GET", f"/pages/{name}")
    assert refused.value.status == HTTPStatus.NOT_FOUND


def test_the_devices_of_a_bench_are_reported_and_a_bench_that_is_wrong_is_named(page):
    reported = tree(page("GET", "/api/bench", name="emulated_floor"))
    assert {row["name"] for row in reported["devices"]} >= {"servos", "imu"}
    assert {row["backend"] for row in reported["devices"]} == {"emulated"}
    with pytest.raises(Refused, match="nothing_like_that"):
        page("GET", "/api/bench", name="nothing_like_that")


def test_a_page_that_is_opened_later_learns_the_whole_path(page):
    lines = [{"live": {"t_s": n / 2, "pose": [n / 100, n / 200, 0.0]}} for n in range(5001)]
    lines += [{"live": {"t_s": 2501.0, "pose": [None, None, None]}}, {"progress": {"what": "x"}}]
    said = "\n".join(map(json.dumps, lines)) + '\n{"live": {"t_s": 25'
    job = job_in(page.results / "console" / "jobs", err=said)
    found = tree(page("GET", "/api/past", job=job.name))
    places = np.array(found["path"])
    assert 1000 < len(places) <= 2000
    assert places[0].tolist() == [0.0, 0.0]
    assert places[-1, 0] == pytest.approx(50.0, abs=0.05)
    assert np.allclose(np.diff(places[:, 0]), places[1, 0]), "evenly thinned"
    assert [figures["t_s"] for figures in found["latest"]][-2:] == [2500.0, 2501.0]
    with pytest.raises(Refused, match="no such run"):
        page("GET", "/api/past", job="../x")


def test_a_held_button_is_a_key_of_hil_jog_until_it_is_let_go_or_stop_is_pressed(page):
    root = page.results / "console" / "jobs"
    mine = jobs.identity(os.getpid())
    job = job_in(root, process=mine, words=["jog", "--body", "--json"])
    os.mkfifo(job.folder / jobs.STDIN)
    pipe, t_ns = os.open(job.folder / jobs.STDIN, os.O_RDWR), 0
    keys = HeldKeys(pipe, lambda: t_ns)
    assert keys.held() == ""
    for key in KEYS:
        t_ns += 10_000_000
        page("POST", "/api/hold", {"job": job.name, "key": key})
        assert keys.held() == key
    t_ns += nanoseconds(LET_GO_S)
    assert keys.held() == KEYS[-1]
    t_ns += 1
    assert keys.held() == ""
    for key in ("x", "ww", "", None, 1):
        with pytest.raises(Refused) as refused:
            page("POST", "/api/hold", {"job": job.name, "key": key})
        assert refused.value.status == HTTPStatus.BAD_REQUEST
    (job.folder / jobs.STOPPED).write_text("{}")
    with pytest.raises(Refused) as refused:
        page("POST", "/api/hold", {"job": job.name, "key": "w"})
    assert refused.value.status == HTTPStatus.CONFLICT
    assert keys.held() == ""
    os.close(pipe)


def test_a_button_moves_nothing_in_what_is_no_jog(page):
    mine = jobs.identity(os.getpid())
    job = job_in(page.results / "console" / "jobs", process=mine, words=["run", "x", "--json"])
    os.mkfifo(job.folder / jobs.STDIN)
    pipe = os.open(job.folder / jobs.STDIN, os.O_RDWR | os.O_NONBLOCK)
    with pytest.raises(Refused) as refused:
        page("POST", "/api/hold", {"job": job.name, "key": "w"})
    assert refused.value.status == HTTPStatus.CONFLICT
    with pytest.raises(BlockingIOError):
        os.read(pipe, 1)
    os.close(pipe)


def test_the_form_of_jog_has_one_choice_and_says_at_it_what_is_missing(tmp_path):
    """An operator chose nothing: the answer came late, cut off, and beside no field."""
    (jog,) = [action for action in actions(tmp_path) if action.name == "jog"]
    names = [field.name for field in jog.fields]
    assert not {"--wheel", "--steer", "--body"} & set(names)
    (what,) = [field for field in jog.fields if field.name == "moves"]
    assert not what.more
    for values in ({}, {"moves": "all wheels"}):
        assert list(jog.problems(values)) == ["moves"]
    for choice in what.choices:
        values = {"moves": choice, "--speed": "0.01"}
        assert jog.problems(values) == {}
        assert f"--{choice.replace(' ', '=')}" in jog.words(values)
