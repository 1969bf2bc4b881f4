"""Exact replay: a pipeline fed with the recorded inputs decides the same bits, and differences are named."""

from __future__ import annotations

import dataclasses
import re
import weakref

import numpy as np
import pytest
from mcap_cases import driving_record

from hil.bench.pipelines import BenchModel
from hil.config.loading import load_bench
from hil.core.errors import DataError, SafetyStop, UsageError
from hil.core.geometry import compose, se2_exp
from hil.core.interfaces import Controller, Estimator
from hil.core.known_names import COMPARED
from hil.core.signals import CycleRecord, Event, Reference, RobotState, WheelSetpoint
from hil.loop.alignment import Alignment, AlignmentParameters
from hil.loop.driven_motion import Motion
from hil.loop.pipeline import ControlPipeline
from hil.loop.safety_limits import SafetyLimits
from hil.loop.supervisor import Supervisor
from hil.recording.mcap_writer import McapRecorder
from hil.recording.runs import RecordedRun, RunStart, read_runs
from hil.replay.difference_limits import Agreement
from hil.replay.estimator_comparison import compare, compare_run, consistency, table, truth_of
from hil.replay.recordings import OpenedRecording
from hil.replay.truth_errors import errors
from hil.replay.verification import DIFFERS, IDENTICAL, RecordedReferences, verify_cycle
from hil.report.replay_page import write_replay_page
from hil.robot.kinematics import WheelGeometry, twist_of_vectors

GEOMETRY = WheelGeometry.nominal()
OTHER_SCALE = 1.0 + 1e-12
"""Of an estimator whose digits differ in the 12th place, in whatever arithmetic."""
START = RobotState(0, np.array([0.1, 1.0 / 3.0, 0.02]), np.zeros(3), np.eye(6) * 1e-6)


class DeadReckoning(Estimator):
    """Integrates wheel increments: small, but every bit depends on all inputs before."""

    def __init__(self, scale: float = 1.0) -> None:
        self.scale = scale

    def reset(self, state):
        self.pose, self.last = state.pose_body_in_wall, None

    def update(self, measurements):
        twist = np.zeros(3)
        for wheels in measurements.wheels:
            if self.last is not None:
                step = (wheels.wheel_angle_rad - self.last) * GEOMETRY.radius_m * self.scale
                heading = wheels.steering_rad
                u = np.column_stack([np.cos(heading), np.sin(heading)]).ravel() * np.repeat(step, 2)
                twist = twist_of_vectors(GEOMETRY, u)
                self.pose = compose(self.pose, se2_exp(twist))
            self.last = wheels.wheel_angle_rad
        return RobotState(
            measurements.t_ns, self.pose, twist * 100.0, np.eye(6) * 1e-6, {"steps": len(measurements.wheels)}
        )


class Proportional(Controller):
    def reset(self):
        pass

    def update(self, state, reference, wheels):
        error = reference.pose_in_wall - state.pose_body_in_wall
        return WheelSetpoint(np.full(4, error[0]), wheels.steering_rad * 0.5)


def verify(cycles, pipeline, start=START):
    """First cycle whose bits a pipeline does not decide again, and its first difference; None for none."""
    pipeline.reset(start)
    for cycle in cycles:
        verdict, difference = verify_cycle(cycle, pipeline, Agreement(), exact=True)
        if verdict == DIFFERS:
            return cycle.cycle, difference
        assert verdict == IDENTICAL
    return None


def line(t_s):
    return Reference(t_s, np.array([0.1 + 0.03 * t_s, 0.33, 0.02]), np.zeros(3), np.zeros(3))


def pipeline(scale=1.0, reference=line, limits=None):
    return ControlPipeline(
        Supervisor(limits or SafetyLimits()),
        Alignment(AlignmentParameters(steer_zero_rad=(0.01, 0.0, 0.0, 0.0))),
        DeadReckoning(scale),
        Proportional(),
        reference,
    )


def run(cycles, pipeline, record_of=driving_record):
    pipeline.reset(START)
    for k in range(cycles):
        source = record_of(k)
        try:
            decision = pipeline.decide(source.inputs)
        except SafetyStop as stop:
            event = Event(source.inputs.t_ns, "error", "supervisor", str(stop))
            yield dataclasses.replace(source, events=(event,))
            return
        yield dataclasses.replace(
            source,
            measurements=decision.measurements,
            state=decision.state,
            reference=decision.reference,
            setpoint=decision.setpoint,
            command=decision.command,
            events=decision.events,
        )


def recorded(path, *runs, start=START):
    recorder = McapRecorder(path, {}, lossless=True)
    for records in runs:
        if start is not None:
            recorder.note(0, "run", RunStart(start, "odometry", "p", ("ekf",), {"shape": "line"}).note())
        for record in records:
            recorder.write(record)
    recorder.close()
    return path


def test_replay_from_the_file_reproduces_every_bit(tmp_path):
    path = recorded(tmp_path / "r", run(250, pipeline()), run(40, pipeline()))
    runs = list(read_runs(path))
    assert [len(r.records) for r in runs] == [250, 40]
    for each in runs:
        assert each.start.trajectory == {"shape": "line"}
        assert each.start.observers == ("ekf",)
        assert verify(each.records, pipeline(), each.start.state) is None
        assert verify(each.records, pipeline(reference=RecordedReferences(each.records))) is None


def test_another_estimator_is_named_with_cycle_and_field(tmp_path):
    (only,) = read_runs(recorded(tmp_path / "r", run(30, pipeline())))
    cycle, difference = verify(only.records, pipeline(OTHER_SCALE), only.start.state)
    assert 1 <= cycle < 30
    assert difference.startswith("state.pose_body_in_wall[")


def test_one_changed_input_bit_is_found():
    records = list(run(30, pipeline()))
    servos = records[11].inputs.servos[0]
    angle = servos.position_rad.copy()
    angle[6] = np.nextafter(angle[6], 10.0)
    servos = dataclasses.replace(servos, position_rad=angle)
    inputs = dataclasses.replace(records[11].inputs, servos=(servos,))
    records[11] = dataclasses.replace(records[11], inputs=inputs)
    cycle, difference = verify(records, pipeline())
    assert (cycle, difference.split(":")[0]) == (11, "measurements.wheels.0.steering_rad[2]")


def test_a_recorded_stop_is_reproduced_and_an_unrecorded_one_named():
    tight = SafetyLimits(tracking_error_limit_m=0.004)
    stopped = list(run(100, pipeline(limits=tight)))
    assert len(stopped) < 100
    assert verify(stopped, pipeline(limits=tight)) is None
    cycle, difference = verify(list(run(100, pipeline())), pipeline(limits=tight))
    assert cycle == len(stopped) - 1
    assert "stopped the robot" in difference


def test_runs_without_a_note_are_distinguished_by_their_cycle_numbers(tmp_path):
    path = recorded(tmp_path / "r", run(20, pipeline()), run(10, pipeline()), start=None)
    runs = list(read_runs(path))
    assert [len(r.records) for r in runs] == [20, 10]
    assert all(r.start is None for r in runs)


def test_the_longest_run_of_a_recording_is_read_without_all_the_others_in_memory(tmp_path):
    path = recorded(tmp_path / "r", *(run(n, pipeline()) for n in (20, 40, 10, 30, 20)))
    seen, most = [], []

    def read():
        for one in read_runs(path):
            seen.append(weakref.ref(one))
            most.append(sum(known() is not None for known in seen))
            yield one

    opened = OpenedRecording(path, None, {}, False, [], read)
    assert len(opened.run().records) == 40
    assert opened.lengths == [20, 40, 10, 30, 20]
    assert max(most) <= 3  # the longest, the latest, the next
    assert len(opened.run(3).records) == 30
    with pytest.raises(UsageError, match="no run 5"):
        opened.run(5)


def test_an_unreadable_start_is_named(tmp_path):
    recorder = McapRecorder(tmp_path / "r", {}, lossless=True)
    recorder.note(0, "run", {"state": {"t_ns": 0}})
    recorder.write(driving_record(0))
    recorder.close()
    problems = []
    (only,) = read_runs(tmp_path / "r", problems)
    assert only.start is None
    assert "how a run began" in problems[0]
    with pytest.raises(DataError, match="how a run began"):
        list(read_runs(tmp_path / "r"))


def moving(scale: float, k: int) -> CycleRecord:
    record = driving_record(k)
    truth = dataclasses.replace(
        record.measurements.mocap[0], pose=np.array([scale * 0.01 * k, 0.0, 0.0]), valid=True
    )
    return dataclasses.replace(record, measurements=dataclasses.replace(record.measurements, mocap=(truth,)))


def test_errors_are_those_of_the_known_truth():
    # Wheels turn 1 rad/s on 25.4 mm: 0.254 mm a cycle. A truth of 0.3 mm a cycle leaves a known ramp.
    records = [moving(0.03, k) for k in range(101)]
    start = dataclasses.replace(START, pose_body_in_wall=np.zeros(3))
    motions = compare(records, {"dead": DeadReckoning(), "scaled": DeadReckoning(0.03 / 0.0254)}, start)
    assert set(motions) == {"recorded", "dead", "scaled"}
    ramp = errors(motions["dead"])
    assert ramp["final_position_m"] == pytest.approx(0.0046, abs=3e-4)
    assert ramp["rmse_position_m"] == pytest.approx(0.0046 / np.sqrt(3), abs=3e-4)
    assert errors(motions["scaled"])["final_position_m"] < 3e-4


def seen_until(records, last):
    """The records without motion capture behind cycle `last`."""
    return [
        r if k <= last else dataclasses.replace(r, measurements=dataclasses.replace(r.measurements, mocap=()))
        for k, r in enumerate(records)
    ]


def test_a_recording_that_ends_in_motion_is_not_held_against_where_the_robot_was():
    """Cut while it drives, its last cycles have no motion capture yet: 7 cycles at 0.254 mm are 1.8 mm."""
    whole = [moving(0.0254, k) for k in range(101)]
    start = dataclasses.replace(START, pose_body_in_wall=np.zeros(3))
    estimators = {"right": DeadReckoning(), "short": DeadReckoning(0.9)}
    seen = compare(whole, estimators, start)
    cut = compare(seen_until(whole, 93), estimators, start)
    for name in estimators:
        motion, until = cut[name], errors(Motion(seen[name].records[:94]))
        assert errors(motion) == pytest.approx(until, rel=1e-9, nan_ok=True)
        assert table(cut)[name]["final_position_m"] == pytest.approx(until["final_position_m"])
        assert consistency(motion)["nees_pose"] == pytest.approx(
            consistency(Motion(seen[name].records[:94]))["nees_pose"]
        )
    assert errors(cut["right"])["max_position_m"] < 3e-4
    assert np.isnan(truth_of(cut["right"])[94:]).all()
    early = compare(seen_until(whole, 60), estimators, start)
    assert np.isnan(errors(early["right"])["final_position_m"])
    assert errors(early["right"])["max_position_m"] < 3e-4


def test_the_last_sample_of_motion_capture_counts_while_the_wheels_rest():
    """The wheels stop at cycle 60 and dither by one step of the encoder, 1.5 mrad."""
    records = []
    for k in range(101):
        stood = moving(0.0254, min(k, 60)).measurements
        (wheels,) = stood.wheels
        dither = 0.0015 * (k % 2 if k > 60 else 0)
        wheels = dataclasses.replace(wheels, wheel_angle_rad=wheels.wheel_angle_rad + dither)
        stamp = driving_record(k).measurements.mocap[0].stamp
        seen = dataclasses.replace(stood.mocap[0], stamp=stamp)
        measured = dataclasses.replace(stood, wheels=(wheels,), mocap=(seen,))
        records.append(dataclasses.replace(driving_record(k), measurements=measured))
    truth = truth_of(Motion(tuple(seen_until(records, 93))))
    np.testing.assert_array_equal(truth[94:], np.tile(truth[93], (7, 1)))


def test_a_run_is_compared_by_kind_and_tabulated():
    start = dataclasses.replace(START, pose_body_in_wall=np.zeros(3))
    only = RecordedRun(RunStart(start, "ekf"), tuple(moving(0.0254, k) for k in range(60)))
    bench = BenchModel(load_bench("emulated_floor"), geometry=GEOMETRY)
    motions = compare_run(only, bench)
    assert list(motions) == ["recorded", *COMPARED]
    assert list(compare_run(only, bench, ("odometry",), recorded=False)) == ["odometry"]
    figures = table(motions)
    assert list(figures) == list(motions)
    for name, motion in motions.items():
        for key, value in (errors(motion) | consistency(motion)).items():
            assert figures[name][key] == (value if np.isfinite(value) else None)
    assert figures["odometry"]["rmse_position_m"] < 1e-3
    with pytest.raises(DataError, match=r"bag.*does not say how its run began"):
        compare_run(RecordedRun(None, only.records), bench, source="bag")


def test_what_was_recorded_of_an_observer_of_ones_own_is_a_row():
    """The shipped ones run again and need none."""
    start = dataclasses.replace(START, pose_body_in_wall=np.zeros(3))
    records = []
    for k in range(20):
        record = moving(0.0254, k)
        (seen,) = record.measurements.mocap
        mine = dataclasses.replace(record.state, pose_body_in_wall=seen.pose + np.array([0.003, 0.004, 0.0]))
        observers = {"ekf": record.state} | ({"mine $x^$": mine} if k else {})
        records.append(dataclasses.replace(record, observers=observers))
    bench = BenchModel(load_bench("emulated_floor"), geometry=GEOMETRY)
    run_of_mine = RecordedRun(RunStart(start, "ekf"), tuple(records))
    motions = compare_run(run_of_mine, bench, ("odometry",))
    assert list(motions) == ["recorded", "recorded mine $x^$", "odometry"]
    found = table(motions)["recorded mine $x^$"]
    for key in ("rmse_position_m", "final_position_m", "max_position_m"):
        assert found[key] == pytest.approx(0.005)


def test_the_page_shows_every_estimator(tmp_path):
    records = [moving(0.03, k) for k in range(60)]
    motions = compare(records, {"dead <reckoning>": DeadReckoning()}, START)
    truth = truth_of(motions["recorded"])
    write_replay_page(tmp_path / "page.html", "Replay", motions, truth, table(motions), ("cut off",))
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "dead &lt;reckoning&gt;" in page
    assert page.count("data:image/svg+xml;base64,") == 3
    assert "RMSE in mm" in page
    assert not re.search(r"\bnan\b", page)
    with pytest.raises(DataError, match="cannot be written"):
        write_replay_page(tmp_path / "page.html" / "page.html", "Replay", motions, truth, table(motions))
