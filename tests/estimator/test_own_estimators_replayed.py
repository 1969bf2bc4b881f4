"""`hil replay --estimator FILE.py:NAME`: an estimator of the user's own beside the shipped ones."""

import json

import numpy as np
import pytest

import hil
from hil.cli import main
from hil.recording.mcap_writer import McapRecorder
from hil.robot.trajectories import line

MINE = """
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.core.signals import RobotState


@dataclass
class Seen:
    pose: np.ndarray


class MotionCapture:
    def reset(self, state):
        self.seen = Seen(state.pose_body_in_wall)

    def update(self, measurements):
        for sample in measurements.mocap:
            if sample.valid:
                self.seen = Seen(sample.pose)
        sigma = np.array([1e-3, 1e-3, 1e-2, 0.1, 0.1, 0.1])
        return RobotState(measurements.t_ns, self.seen.pose, np.zeros(3), np.diag(sigma**2))


class OfTheBench(MotionCapture):
    def __init__(self, bench):
        self.offset = np.array([bench.geometry.radius_m[0], 0.0, 0.0])

    def update(self, measurements):
        state = super().update(measurements)
        pose = state.pose_body_in_wall + self.offset
        return RobotState(state.t_ns, pose, state.twist_body, state.covariance)


class LosesItself(MotionCapture):
    def update(self, measurements):
        state = super().update(measurements)
        pose = state.pose_body_in_wall * (np.nan if measurements.cycle >= 20 else 1.0)
        return RobotState(state.t_ns, pose, state.twist_body, state.covariance)


class Overconfident(MotionCapture):
    def update(self, measurements):
        state = super().update(measurements)
        sign = -1.0 if measurements.cycle >= 20 else 1.0
        return RobotState(state.t_ns, state.pose_body_in_wall, state.twist_body, sign * state.covariance)


class Late(MotionCapture):
    def update(self, measurements):
        state = super().update(measurements)
        late_ns = 1_000_000_000 if measurements.cycle >= 20 else 0
        return RobotState(state.t_ns - late_ns, state.pose_body_in_wall, state.twist_body, state.covariance)


class Divides(MotionCapture):
    def update(self, measurements):
        return 1 / 0


class NoState(MotionCapture):
    def update(self, measurements):
        return None


class NoReset:
    def update(self, measurements):
        return None


class Refuses(MotionCapture):
    def __init__(self):
        raise ValueError("no licence")
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A short recorded line, and estimators of one's own beside it."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "mine.py").write_text(MINE)
    (folder / "broken.py").write_text("x = (\n")
    with hil.open_bench("emulated_floor", seed=3) as bench:
        bench.devices.actuators().enable()
        start = bench.settle(0.3)
        bench.add_sink(McapRecorder(folder / "line.mcap", bench.header(), lossless=True))
        bench.drive(line(start, start + np.array([0.05, 0.0, 0.0]), duration_s=2.0), start_pose=start)
    return folder


@pytest.fixture
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return folder


def replayed(capsys, *estimators, page=None):
    words = [word for one in estimators for word in ("--estimator", one)]
    words += ["--page", str(page)] if page else []
    code = main(["replay", "line.mcap", "--json", *words])
    said = capsys.readouterr()
    return code, json.loads(said.out), said.err


@pytest.mark.parametrize("named", ["mine.py:MotionCapture", "mine:MotionCapture"])
def test_it_stands_beside_the_shipped_ones_in_the_order_of_the_rows(here, tmp_path, capsys, named):
    page = tmp_path / "page.html"
    code, reported, _ = replayed(capsys, named, "ekf", page=page)
    assert named in page.read_text()
    assert code == 0
    assert list(reported["estimators"]) == ["recorded", "ekf", named]
    assert reported["estimators"][named]["rmse_position_m"] < 1e-3
    assert reported["warnings"] == []


def test_one_that_needs_an_argument_is_given_the_bench_of_the_recording(here, capsys):
    """It is off by its bench's wheel radius, and by nothing else."""
    _, reported, _ = replayed(capsys, "mine.py:OfTheBench")
    assert list(reported["estimators"]) == ["recorded", "mine.py:OfTheBench"]
    assert reported["estimators"]["mine.py:OfTheBench"]["final_position_m"] == pytest.approx(0.0254, abs=2e-3)


def test_cycles_without_a_finite_pose_are_counted_in_a_warning(here, capsys):
    code, reported, err = replayed(capsys, "mine.py:LosesItself")
    assert code == 0
    (warning,) = reported["warnings"]
    cycles = reported["cycles"]
    assert warning.startswith("mine.py:LosesItself: ")
    assert f"in {cycles - 20} of {cycles} cycles, the first of them 20;" in warning
    assert f"warning: {warning}" in err
    assert reported["estimators"]["mine.py:LosesItself"]["final_position_m"] is None


@pytest.mark.parametrize("named", ["mine.py:Overconfident", "mine.py:Late"])
def test_states_that_the_loop_would_refuse_do_not_end_with_0(here, capsys, named):
    code, reported, err = replayed(capsys, named)
    assert code == 2
    (problem,) = reported["problems"]
    cycles = reported["cycles"]
    assert problem.startswith(f"{named}: ")
    assert f"(cycle 20; {cycles - 20} of {cycles} cycles" in problem
    assert problem in err


@pytest.mark.parametrize(
    ("named", "said"),
    [
        ("mine.py:Divides", "mine.py:Divides: ZeroDivisionError: division by zero (mine.py, line "),
        ("mine.py:NoState", "update() returned None (from cycle 0 on)"),
        ("mine.py:NoReset", "has no reset"),
        ("mine.py:Refuses", "ValueError: no licence (mine.py, line "),
        ("mine.py:MotionCaptur", "expected one of MotionCapture, "),
        ("mine.py", "as mine.py:NAME"),
        ("broken.py:X", "broken.py: line 1: "),
        ("absent.py:X", "absent.py: no such file"),
        ("efk", "did you mean ekf?"),
    ],
)
def test_what_cannot_be_used_is_named(here, capsys, named, said):
    assert main(["replay", "line.mcap", "--estimator", named]) == 2
    out, err = capsys.readouterr()
    assert said in err
    assert "Traceback" not in err
    assert out == ""
