"""A varied setting that changed nothing is named: it has not been tested."""

import json

from hil.campaign import Case, Row, alike
from hil.cli import main

SCRIPT = '''
"""One of its parameters is never used."""
from dataclasses import dataclass

from hil.procedure import Measurement, procedure


@dataclass
class Parameters:
    used: float = 0.0
    idle: float = 0.0


@procedure(name="idle", parameters=Parameters, measurements=[Measurement("sum", "mm", high=50.0)])
def run(ctx):
    """Add seed and parameter."""
    ctx.measure("sum", ctx.seed + ctx.parameters.used)
'''


def row(seed, value, verdict="PASS", **settings):
    measured = {"end": {"unit": "mm", "value": value, "outcome": verdict, "low": None, "high": None}}
    return Row(Case(seed, tuple(settings.items())), "", verdict, 0, 1.0, measured)


def test_terminal_data_and_page_say_which_setting_changed_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "idle.py").write_text(SCRIPT)
    options = ("--seeds", "0:2", "--vary", "used=1,2", "--vary", "idle=3,4,5", "--workers", "0")
    assert main(["campaign", "idle.py", *options, "--keep", "results", "--out", "o"]) == 0
    said = capsys.readouterr().out
    reported = "idle: 3, 4, 5 gave the same values in every run, to the last bit"
    assert reported in said
    assert "used: " not in said
    assert json.loads((tmp_path / "o" / "campaign.json").read_text())["alike"] == [
        {"key": "idle", "values": ["3", "4", "5"]}
    ]
    assert reported in (tmp_path / "o" / "campaign.html").read_text()


def test_only_the_values_that_are_alike_in_every_run_are_named():
    rows = [row(k, v, a=a) for a, v in (("x", 1.0), ("y", 2.0), ("z", 1.0)) for k in (0, 1)]
    assert alike(rows) == [{"key": "a", "values": ["x", "z"]}]
    assert alike([*rows[:5], row(1, 1.0 + 1e-15, a="z")]) == []
    assert alike([*rows[:5], row(1, 1.0, "FAIL", a="z")]) == []


def test_a_run_that_ended_in_an_error_does_not_hide_what_the_others_show():
    rows = [
        row(0, 1.0, a="x"),
        row(0, 1.0, a="y"),
        row(1, None, "ERROR", a="x"),
        row(1, None, "ERROR", a="y"),
    ]
    assert alike(rows) == [{"key": "a", "values": ["x", "y"]}]
