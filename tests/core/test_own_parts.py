"""Controllers and estimators of one's own: wrong results are named, and recordings say whose they are.

What they are given they cannot spoil for the others.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import hil
from hil.cli import main
from hil.core.errors import UsageError
from hil.core.signals import RobotState, WheelSetpoint
from hil.recording.mcap_writer import McapRecorder
from hil.recording.runs import RunStart, read_runs
from hil.replay.estimator_comparison import estimate
from hil.robot.trajectories import line

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
    """An estimator that stays where it is; from some call on it returns what it is asked to make of that."""

    def reset(self, state):
        self.state, self.calls = state, 0

    def update(self, measurements):
        self.calls, self.cycle = self.calls + 1, measurements.cycle
        known = replace(self.state, t_ns=measurements.t_ns)
        return known if self.calls <= self.after else self.found(known)


class Writer(Clueless):
    """An estimator that writes into the arrays it is given, from its sixth cycle on."""

    def update(self, measurements):
        if measurements.cycle > 5:
            for sample in getattr(measurements, self.found):
                for value in vars(sample).values():
                    if isinstance(value, np.ndarray):
                        value[:] = 7.0
        return replace(self.state, t_ns=measurements.t_ns)


@pytest.fixture
def bench():
    with hil.open_bench("emulated_floor") as opened:
        yield opened


def run(bench, cycles=20, observers=None, **parts):
    """A run with parts of one's own; the cycles that were decided."""
    pipeline = bench.make_pipeline(WAY)
    for name, part in parts.items():
        setattr(pipeline, name, part)
    pipeline.observers = observers or {}
    bench.devices.actuators().enable()
    records = []

    def until(record):
        records.append(record)
        return len(records) == cycles

    start = RunStart(bench.start_state(), "ekf", trajectory=WAY.to_mapping())
    bench.run(pipeline, start, until)
    return records


@pytest.mark.parametrize(
    ("found", "reported"),
    [
        (None, "None"),
        (WheelSetpoint(0.5, FOUR), "a WheelSetpoint whose wheel_rate_rad_s is of type float: 0.5"),
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
def test_a_controller_that_returns_no_setpoints_is_named(bench, found, reported):
    with pytest.raises(
        UsageError, match=rf"^controller Mine: update\(\) returned {reported}.*; expected a W"
    ):
        run(bench, controller=Mine(found))


def test_a_controller_that_returns_nothing_later_on_is_named_too(bench):
    said = r"^controller Mine: update\(\) returned None \(from cycle 9 on\); expected a WheelSetpoint"
    with pytest.raises(UsageError, match=said):
        run(bench, controller=Mine(None, after=9))


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["wheel_rate_rad_s", "steering_rad"])
def test_a_controller_that_loses_itself_is_named_with_the_cycle(bench, name, value):
    lost = replace(WheelSetpoint(FOUR, FOUR), **{name: np.array([0.0, value, 0.0, 0.0])})
    said = rf"^controller Mine: .* whose {name} is \[0\.0, {value}, .*from cycle 9 on.*; expected finite"
    with pytest.raises(UsageError, match=said):
        run(bench, controller=Mine(lost, after=9))


def state(**fields):
    return lambda known: replace(known, **fields)


@pytest.mark.parametrize(
    ("found", "reported"),
    [
        (lambda known: None, "None"),
        (lambda known: known.pose_body_in_wall, r"an array of shape \(3,\)"),
        (state(covariance=np.eye(3)), r"a RobotState whose covariance is an array of shape \(3, 3\)"),
        (state(pose_body_in_wall=(0.0, 0.0, 0.0)), "a RobotState whose pose_body_in_wall is of type tuple"),
        (state(t_ns=0.5), "a RobotState whose t_ns is of type float: 0.5"),
        (state(diagnostics=None), "a RobotState whose diagnostics are None"),
        (state(twist_body=np.zeros(3, dtype=complex)), "whose twist_body is an array .* type complex128"),
        (state(covariance=np.triu(np.ones((6, 6)))), r"covariance\[0, 1\] is 1, and \[1, 0\] is 0"),
        (state(t_ns=2**63), "a RobotState whose t_ns is of type int: 9223372036854775808"),
        (state(diagnostics={"mode": "slip"}), r"diagnostics\['mode'\] is of type str: 'slip'"),
        (state(diagnostics={"far": np.inf}), r"diagnostics\['far'\] is of type float: inf"),
        (state(diagnostics={3: 0.5}), "diagnostics have a name of type int: 3"),
    ],
)
@pytest.mark.parametrize(("observes", "after"), [(False, 0), (True, 9)])
def test_an_estimator_that_returns_no_state_is_named(bench, found, reported, observes, after):
    mine = Clueless(found, after)
    parts = {"observers": {"mine": mine}} if observes else {"estimator": mine}
    with pytest.raises(
        UsageError, match=rf"^estimator Clueless: update\(\) returned .*{reported}.*; expected"
    ) as e:
        run(bench, **parts)
    assert f" (from cycle {mine.cycle} on); expected " in str(e.value)
    assert mine.calls == after + 1


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
    first, second, third = (
        reported["difference"] for reported in json.loads(capsys.readouterr().out)["runs"]
    )
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


def test_what_is_right_within_rounding_passes(bench):
    nearly = np.eye(6) + np.triu(np.full((6, 6), 1e-12), 1)
    figures = {"count": 3, "unknown": np.nan, "flag": np.True_, "single": np.float32(0.5)}
    fine = state(covariance=nearly, diagnostics=figures, t_ns=np.int64(0))

    def of_now(known):
        return replace(fine(known), t_ns=np.int64(known.t_ns))

    last = run(bench, estimator=Clueless(of_now))[-1].state
    reported = [last.diagnostics[name] for name in ("count", "flag", "single")]
    assert reported == [3.0, 1.0, 0.5]
    assert {type(value) for value in reported} == {float}
    assert type(last.t_ns) is int


def every_sample(records):
    """All arrays of all measurements, one after the other."""
    kinds = ("wheels", "gyro", "tracker", "mocap")
    samples = [s for r in records for kind in kinds for s in getattr(r.measurements, kind)]
    return np.concatenate([v for s in samples for v in vars(s).values() if isinstance(v, np.ndarray)])


@pytest.mark.parametrize("observes", [False, True])
@pytest.mark.parametrize("kind", ["wheels", "tracker"])
def test_an_estimator_cannot_write_into_what_it_is_given(bench, kind, observes):
    mine = Writer(kind)
    parts = {"observers": {"mine": mine}} if observes else {"estimator": mine}
    with pytest.raises(ValueError, match="read-only") as caught:
        run(bench, cycles=60, **parts)
    assert caught.traceback[-1].path.name == "test_own_parts.py"


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_controller_cannot_write_into_what_it_is_given(bench, place):
    def spoil(*given):
        next(v for v in vars(given[place]).values() if isinstance(v, np.ndarray))[:] = 7.0

    with pytest.raises(ValueError, match="read-only"):
        run(bench, controller=Mine(spoil, after=3))


def test_what_stands_beside_parts_of_ones_own_is_as_without_them(tmp_path):
    """All shipped estimators, several samples in one cycle, a recording: the same to the bit."""
    shipped, reported = ("ekf", "ukf", "odometry"), []
    for own in (False, True):
        path = tmp_path / f"{own}.mcap"
        with hil.open_bench("emulated_floor") as bench:
            bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
            pipeline = bench.make_pipeline(WAY, observers=shipped)
            records = run(
                bench, 60, pipeline.observers | ({"mine": Clueless(lambda known: known)} if own else {})
            )
        (found,) = read_runs(path)
        assert max(len(r.measurements.mocap) + len(r.measurements.gyro) for r in records) > 1
        states = [[r.observers[name].pose_body_in_wall for name in shipped] for r in found.records]
        reported.append((np.array(states), every_sample(found.records)))
        assert records[0].measurements.wheels[0].wheel_angle_rad.flags.writeable
    for without, beside in zip(*reported, strict=True):
        assert np.array_equal(without, beside, equal_nan=True)


class Reusing(Clueless):
    """An estimator that goes on with the arrays it was given at first, and returns the same ones always."""

    def update(self, measurements):
        self.state.pose_body_in_wall[:] += 1e-4
        return replace(self.state, t_ns=measurements.t_ns)


def test_an_estimator_may_return_the_same_arrays_in_every_cycle(bench):
    records = run(bench, estimator=Reusing(None), observers={"other": Clueless(lambda known: known)})
    ways = [r.state.pose_body_in_wall[0] - records[0].state.pose_body_in_wall[0] for r in records]
    assert ways == pytest.approx(1e-4 * np.arange(20))
    assert len({r.observers["other"].pose_body_in_wall[0] for r in records}) == 1


def test_a_comparison_guards_what_is_recorded_as_a_run_does(bench):
    records = run(bench, cycles=40)
    start, before = bench.start_state(), every_sample(records)
    with pytest.raises(ValueError, match="read-only"):
        estimate(records, Writer("wheels"), start)
    assert np.array_equal(before, every_sample(records), equal_nan=True)
    with pytest.raises(UsageError, match=r"^estimator Clueless: .* shape \(2,\) .*\(from cycle 7 on\)"):
        estimate(records, Clueless(state(pose_body_in_wall=np.zeros(2)), after=7), start)


@pytest.mark.parametrize(
    ("fields", "reported"),
    [
        ({"pose_body_in_wall": np.full(3, np.nan)}, "the estimated state is not finite"),
        ({"covariance": -np.eye(6)}, "the estimate's variance of x, .* is negative"),
        ({"covariance": np.full((6, 6), np.nan)}, "the estimate has no usable covariance"),
        ({"t_ns": 0}, "the estimate's time is .* s behind that of the cycle"),
    ],
)
def test_an_observer_that_cannot_be_used_is_warned_of_once_in_a_run(bench, fields, reported):
    for _ in range(2):
        records = run(
            bench, observers={"mine": Clueless(state(**fields), after=3), "other": Clueless(state())}
        )
        noticed = [(r.cycle - records[0].cycle, e) for r in records for e in r.events if e.source == "mine"]
        ((cycle, event),) = noticed
        assert cycle == 3
        assert event.level == "warning"
        assert re.match(rf"observer mine: {reported}", event.message)
        assert not [e for r in records for e in r.events if e.source == "other"]
