"""Controllers and estimators of one's own: wrong results are named, and recordings say whose they are."""

import json
from dataclasses import replace

import numpy as np
import pytest

import hil
from hil.cli import main
from hil.recording.mcap_writer import McapRecorder
from hil.recording.runs import RunStart, read_runs
from hil.ring.own_parts import own_name
from hil.robot.trajectories import line
from hil.vocabulary.errors import UsageError
from hil.vocabulary.signals import RobotState, WheelSetpoint

WAY = line((0, 0, 0), (0.02, 0, 0), duration_s=1.0)
FOUR, THREE = np.zeros(4), np.zeros(3)


class Mine:
    """A controller and an estimator that return what they are given, from some call on."""

    def __init__(self, found, after=0):
        self.found, self.after = found, after

    def reset(self, state=None):
        self.calls = 0

    def update(self, *given):
        self.calls += 1
        if self.calls <= self.after:
            return WheelSetpoint(FOUR, FOUR)
        return self.found(*given) if callable(self.found) else self.found


class Clueless(Mine):
    """An estimator that stays where it is."""

    def reset(self, state):
        self.state = state

    def update(self, measurements):
        return self.found(replace(self.state, t_ns=measurements.t_ns))


@pytest.fixture
def bench():
    with hil.open_bench("emulated_floor") as opened:
        yield opened


def run(bench, cycles=20, observers=None, **parts):
    """A run with parts of one's own; the cycles that were decided."""
    brain = bench.make_brain(WAY)
    for name, part in parts.items():
        setattr(brain, name, part)
    brain.observers = observers or {}
    bench.rig.actuators().enable()
    records = []

    def until(record):
        records.append(record)
        return len(records) == cycles

    start = RunStart(bench.start_state(), "ekf", trajectory=WAY.to_mapping())
    bench.run(brain, start, until)
    return records


@pytest.mark.parametrize(
    ("found", "told"),
    [
        (None, "None"),
        ((FOUR, FOUR), "of type tuple: "),
        (WheelSetpoint(0.5, FOUR), "a WheelSetpoint whose wheel_rate_rad_s is of type float: 0.5"),
        (WheelSetpoint([0.0] * 4, FOUR), "a WheelSetpoint whose wheel_rate_rad_s is of type list: "),
        (
            WheelSetpoint(FOUR, THREE),
            r"a WheelSetpoint whose steering_rad is an array of shape \(3,\) and type",
        ),
        (
            WheelSetpoint(FOUR, FOUR.astype(int)),
            "a WheelSetpoint whose steering_rad is an array .* type int64",
        ),
    ],
)
def test_a_controller_that_returns_no_setpoints_is_named(bench, found, told):
    with pytest.raises(UsageError, match=rf"^controller Mine: update\(\) returned {told}.*; expected a W"):
        run(bench, controller=Mine(found))


def test_a_controller_that_returns_nothing_later_on_is_named_too(bench):
    with pytest.raises(UsageError, match=r"^controller Mine: update\(\) returned None; expected a Wheel"):
        run(bench, controller=Mine(None, after=9))


def state(**fields):
    return lambda known: replace(known, **fields)


@pytest.mark.parametrize(
    ("found", "told"),
    [
        (lambda known: None, "None"),
        (lambda known: known.pose_body_in_wall, r"an array of shape \(3,\)"),
        (state(covariance=np.eye(3)), r"a RobotState whose covariance is an array of shape \(3, 3\)"),
        (state(pose_body_in_wall=(0.0, 0.0, 0.0)), "a RobotState whose pose_body_in_wall is of type tuple"),
        (state(t_ns=0.5), "a RobotState whose t_ns is of type float: 0.5"),
        (state(diagnostics=None), "a RobotState whose diagnostics are None"),
    ],
)
@pytest.mark.parametrize("observes", [False, True])
def test_an_estimator_that_returns_no_state_is_named(bench, found, told, observes):
    mine = Clueless(found)
    parts = {"observers": {"mine": mine}} if observes else {"estimator": mine}
    with pytest.raises(UsageError, match=rf"^estimator Clueless: update\(\) returned .*{told}.*; expected"):
        run(bench, **parts)


def test_ours_have_no_name_of_their_own(bench):
    brain = bench.make_brain(WAY, observers=("ukf", "odometry"))
    ours = (brain.controller, brain.estimator, *brain.observers.values(), None)
    assert [own_name(part) for part in ours] == [""] * 5


def test_a_recording_names_parts_that_replay_cannot_make(bench, tmp_path, capsys):
    path = tmp_path / "own.mcap"
    bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
    mine, unmoved = Mine(WheelSetpoint(FOUR, FOUR)), Clueless(lambda known: known)
    run(bench)
    run(bench, controller=mine)
    run(bench, estimator=unmoved, observers={"still": Clueless(lambda known: known)})
    bench.close()
    starts = [found.start for found in read_runs(path)]
    law, filters = f"{__name__}.Mine", f"{__name__}.Clueless"
    assert [start.controller for start in starts] == [None, law, None]
    assert [start.feedback for start in starts] == ["ekf", "ekf", filters]
    assert starts[2].observers == (filters,)
    assert main(["replay", str(path), "--verify", "--json"]) == 1
    first, second, third = (told["difference"] for told in json.loads(capsys.readouterr().out)["runs"])
    assert first is None
    assert second == f"controller {law}: not part of this package, so that replay cannot make it again"
    assert third.startswith(f"estimator {filters} and estimator {filters}: not part of this package")
    assert main(["replay", str(path), "--run", "1", "--estimator", "odometry"]) == 0


def test_a_state_and_its_setpoints_may_be_of_a_derived_class(bench):
    class State(RobotState):
        """With more to say."""

    def more(known):
        return State(known.t_ns, known.pose_body_in_wall, known.twist_body, known.covariance)

    assert len(run(bench, estimator=Clueless(more))) == 20
