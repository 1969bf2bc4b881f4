"""`--controller` of `hil run` and `hil live`: a law, or a class of the user's own, in a file or a module."""

import json
import sys

import pytest

from hil.bench import make_bench_model
from hil.cli import main
from hil.core.errors import ConfigError
from hil.recording.runs import read_runs
from hil.user_code.roles import CONTROLLER

MINE = """
import numpy as np
from hil.core.signals import WheelSetpoint


class Ahead:
    "Rolls ahead at a tenth of what the reference asks for."

    def __init__(self, bench):
        self.radius_m = float(np.mean(bench.geometry.radius_m))

    def reset(self):
        self.cycles = 0

    def update(self, state, reference, wheels):
        rate_rad_s = 0.1 * reference.twist_body[0] / self.radius_m
        return WheelSetpoint(np.full(4, rate_rad_s), np.zeros(4))


class NoUpdate:
    def reset(self):
        pass


class Refuses:
    def __init__(self):
        raise ValueError("no licence")

    reset = update = None


class TakesTwo(Ahead):
    def __init__(self, bench, gain):
        super().__init__(bench)


class ByName(Ahead):
    def __init__(self, bench, *, gain):
        super().__init__(bench)


class Short(Ahead):
    def update(self, state, reference):
        return None


class Fuller(Ahead):
    def update(self, state, reference, wheels, more=None, *others):
        return super().update(state, reference, wheels)


def ahead_of(bench):
    return Ahead(bench)


class Lost(Ahead):
    def update(self, state, reference, wheels):
        return WheelSetpoint(np.full(4, np.nan), np.zeros(4))
"""
STRAIGHT = """
import numpy as np
from hil.procedure import Context, Measurement, procedure
from hil.procedure.tracking_errors import enable_hold
from hil.robot.trajectories import line

@procedure(name="straight", needs=("servos",), measurements=(Measurement("way", "m"),))
def run(ctx: Context) -> None:
    \"\"\"Drives 0.05 m.\"\"\"
    start = enable_hold(ctx.bench)
    motion = ctx.bench.drive(line(start, start + np.array([0.05, 0.0, 0.0]), duration_s=2.0), hold_s=0.1)
    ctx.measure("way", float(ctx.bench.truth().pose_body_in_wall[0] - start[0]))
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "straight.py").write_text(STRAIGHT)
    (tmp_path / "broken.py").write_text("import nowhere_at_all\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name in ("mine", "broken"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    yield tmp_path
    for name in ("mine", "broken"):
        sys.modules.pop(name, None)


def run(capsys, *options):
    words = ["run", "straight.py", "--set", "bench.environment.tilt_rad=0.0", "--out", "results", "--json"]
    code = main([*words, *options])
    said = capsys.readouterr()
    return code, json.loads(said.out), said.err


def driven_by(folder):
    """Controllers of the runs in the recording that moved."""
    (path,) = (folder / "results").glob("*.mcap")
    return [r.start.controller for r in read_runs(path) if r.start.trajectory is not None]


def test_a_class_of_ones_own_drives_what_the_procedure_asks_for(here, capsys):
    code, reported, err = run(capsys, "--controller", "mine.py:Ahead")
    assert code == 0, err
    (way,) = (row["value"] for row in reported["measurements"] if row["name"] == "way")
    assert way == pytest.approx(0.005, abs=0.0025), "a tenth of 0.05 m"
    assert driven_by(here) == ["hil_script_mine.Ahead"]
    assert json.loads((here / "results" / "result.json").read_text())["controller"] == "mine.py:Ahead"


@pytest.mark.parametrize("named", ["mine.py:Ahead", "mine.py:Fuller", "mine.py:ahead_of", "nonlinear"])
def test_what_can_be_called_is_not_refused(here, named):
    CONTROLLER.check(named)


def test_what_a_function_makes_is_looked_at_too(here):
    (here / "made.py").write_text("from mine import Short\n\n\ndef short(bench):\n    return Short(bench)\n")
    with pytest.raises(ConfigError, match=r"made\.py:short: update\(state, reference\) cannot be called"):
        CONTROLLER.make("made.py:short", make_bench_model("emulated"))


def test_a_law_is_that_of_the_bench_for_this_run(here, capsys):
    code, _, err = run(capsys, "--controller", "nonlinear")
    assert code == 0, err
    assert driven_by(here) == ["nonlinear"]


def test_what_it_returns_is_limited_and_checked_as_ever(here, capsys):
    code, reported, _ = run(capsys, "--controller", "mine:Lost")
    assert code == 2
    for part in ("controller Lost", "wheel_rate_rad_s", "nan", "cycle"):
        assert part in reported["error"]["message"]
    assert reported["held"]["state"] in ("HELD", "not needed")


RUN = ("run", "straight.py")


@pytest.mark.parametrize(
    ("words", "named", "reported"),
    [
        (RUN, "optimaal", "did you mean optimal?"),
        (RUN, "mine.py", "mine.py:NAME"),
        (RUN, "mine:Ahaed", "did you mean Ahead?"),
        (RUN, "nothing_here:Ahead", "nothing_here"),
        (RUN, "nothing.py:Ahead", "nothing.py"),
        (RUN, "broken:Ahead", "nowhere_at_all"),
        (("live", "--duration", "1"), "mine:Ahaed", "did you mean Ahead?"),
        (RUN, "mine.py:ahead_off", "did you mean ahead_of?"),
        (RUN, "mine.py:TakesTwo", "TakesTwo(bench, gain) also needs gain (mine.py, line "),
        (RUN, "mine.py:ByName", "also needs gain (mine.py, line "),
        (
            RUN,
            "mine.py:Short",
            "update(self, state, reference) cannot be called as update(state, reference, ",
        ),
    ],
)
def test_a_name_that_is_wrong_is_refused_before_anything_opens(here, capsys, words, named, reported):
    assert main([*words, "--controller", named]) == 2
    error = capsys.readouterr().err
    assert reported in error
    assert "--controller" in error
    assert "Traceback" not in error
    assert not any(here.rglob("*.mcap"))


@pytest.mark.parametrize(
    ("named", "reported"), [("mine:NoUpdate", "no update"), ("mine:Refuses", "no licence")]
)
def test_one_that_cannot_be_made_ends_the_run_with_its_reason(here, capsys, named, reported):
    code, found, _ = run(capsys, "--controller", named)
    assert code == 2
    assert reported in found["error"]["message"]
