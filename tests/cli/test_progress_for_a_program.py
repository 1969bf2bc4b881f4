"""`--progress json`: a program reads how far a command is, what it asks, and how the robot does."""

import io
import json
import sys

import pytest

from hil.cli import main

SCRIPT = '''
"""Asks, stands, and says the answers."""
from hil.procedure import procedure


@procedure(name="asking", needs=("servos",), bench="emulated_floor")
def run(ctx):
    """Ask for a colour."""
    with ctx.step("a question"):
        ctx.note("the colour is " + ctx.prompt("which colour?"))
    with ctx.step("a look"):
        ctx.bench.observe(0.1, feedback="odometry")
'''


@pytest.fixture
def asking(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "asking.py").write_text(SCRIPT)
    monkeypatch.setattr(sys, "stdin", io.StringIO("blue\n"))
    return ["run", "asking.py", "--answers", "-", "--json", "--out", "there"]


def objects(text, kind):
    trees = [json.loads(line) for line in text.splitlines() if line.startswith("{")]
    return [tree[kind] for tree in trees if kind in tree]


def test_a_program_sees_steps_question_figures_and_how_the_robot_was_left(asking, capsys):
    assert main(["--progress", "json", *asking]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["notes"] == ["the colour is blue"]
    steps = [(p["what"], p["done"], p["total"]) for p in objects(err, "progress")]
    assert steps == [("a question", 0, 1), ("a question", 1, 1), ("a look", 0, 1), ("a look", 1, 1)]
    assert objects(err, "question") == ["which colour?"]
    assert objects(err, "answered") == ["blue"]
    live = objects(err, "live")
    assert len(live[0]["pose"]) == 3
    assert live[0]["devices"]["servos"]["status"] == "ok"
    assert objects(err, "held")[0]["state"] == "not needed"


def test_a_person_with_answers_on_standard_input_sees_the_question_alone(asking, capsys):
    assert main(asking) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["notes"] == ["the colour is blue"]
    assert "which colour?" in err.splitlines()
    assert "{" not in err


def test_a_question_without_a_line_ends_the_run_in_order(asking, monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert main(asking) == 4
    assert json.loads(capsys.readouterr().out)["error"]
