"""Figures for a program that watches: now and then, as JSON has them."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from hil.bench import open_bench
from hil.config.loading import load_bench
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import SafetyStop
from hil.core.interfaces import Sink
from hil.core.signals import Event
from hil.monitor.status_stream import StatusStream
from hil.robot.trajectories import line


class At(Clock):
    """A clock that is set."""

    def __init__(self):
        self.ns = 0

    def now_ns(self):
        return self.ns

    def sleep_until_ns(self, t_ns):
        self.ns = t_ns

    def schedule(self, task, due_ns):
        raise AssertionError


class ToldInTime(Sink):
    """A stream on the bench's own time; keeps what is told, each with its time, s."""

    def __init__(self, bench):
        self.told, self._clock = [], bench.clock
        self._stream = StatusStream(self._tell, bench.clock, bench.config)

    def _tell(self, kind, data):
        self.told.append((kind, data, self._clock.now_ns() / 1e9))

    def write(self, record):
        self._stream.write(record)

    def rest(self):
        self._stream.rest()

    def note(self, t_ns, kind, data):
        self._stream.note(t_ns, kind, data)

    def watched(self, robot):
        self._stream.watched(robot)

    def close(self):
        self._stream.close()


class Kept(Sink):
    def __init__(self):
        self.records = []

    def write(self, record):
        self.records.append(record)

    def close(self):
        pass


BENCH = load_bench("emulated_floor")


@pytest.fixture(scope="module")
def records():
    kept = Kept()
    with open_bench("emulated_floor") as bench:
        bench.add_sink(kept)
        bench.observe(0.2, feedback="odometry")
    return kept.records


def test_it_reports_twice_a_second_and_counts_what_came_between(records):
    reported, clock = [], At()
    stream = StatusStream(lambda kind, data: reported.append((kind, data)), clock, BENCH)
    for number, record in enumerate(records[:9]):
        clock.ns = number * nanoseconds(0.125)
        stream.write(record)
        stream.rest()
    assert [kind for kind, _ in reported] == ["live"] * 3
    assert [round(data["t_s"], 3) for _, data in reported][:2] == [0.0, 0.04]
    stream.close()
    clock.ns += nanoseconds(1.0)
    stream.write(records[9])
    stream.rest()
    assert reported[-1][1]["t_s"] == 0.0  # a bench that is opened again has a time of its own
    servos = reported[1][1]["devices"]["servos"]
    came = sum(len(r.inputs.servos) for r in records[1:5])
    assert (servos["status"], servos["due_hz"]) == ("ok", 100.0)
    assert servos["rate_hz"] == pytest.approx(came / 0.04, rel=1e-3)
    assert abs(servos["age_ms"]) < 10.0
    shown = servos["values"]["Servo angles (rad)"]
    seen = [s for r in records[:5] for s in r.inputs.servos][-1]
    assert list(shown.values()) == pytest.approx(seen.position_rad.tolist(), rel=1e-4, abs=1e-6)


def test_every_device_of_the_bench_is_there_with_values_or_as_one_that_sent_nothing(records):
    reported, clock = [], At()
    stream = StatusStream(lambda kind, data: reported.append(data), clock, BENCH)
    stream.write(replace(records[0], inputs=replace(records[0].inputs, imu=(), mocap=())))
    stream.rest()
    for record in records:
        stream.write(record)
        stream.rest()
    clock.ns = nanoseconds(1.0)
    stream.write(records[-1])
    stream.rest()
    first, last = reported
    assert set(first["devices"]) == set(last["devices"]) == set(BENCH.devices())
    assert (first["devices"]["imu"]["status"], first["devices"]["imu"]["values"]) == ("nothing yet", {})
    assert all(told["values"] for told in last["devices"].values())


def test_what_is_unknown_is_null_and_events_stay(records):
    reported, clock = [], At()
    stream = StatusStream(lambda kind, data: reported.append(data), clock, BENCH)
    first = records[0]
    state = replace(first.state, pose_body_in_wall=np.array([np.nan, 0.1, 0.2]))
    stream.write(replace(first, state=state, events=(Event(first.inputs.t_ns, "warning", "imu", "stuck"),)))
    stream.rest()
    clock.ns = nanoseconds(1.0)
    stream.write(first)
    stream.rest()
    assert json.loads(json.dumps(reported[0], allow_nan=False))["pose"] == [None, 0.1, 0.2]
    assert [figures["events"] for figures in reported] == [["0.00 s, warning, imu: stuck"]] * 2


def test_how_the_robot_was_left_is_passed_on_and_nothing_else_that_is_noted(records):
    reported = []
    stream = StatusStream(lambda kind, data: reported.append((kind, data)), At(), BENCH)
    stream.note(0, "run", {})
    stream.note(0, "held", {"state": "HELD"})
    assert reported == [("held", {"state": "HELD"})]


@pytest.mark.parametrize(
    ("fault", "device", "state"),
    [("tracker:off@1.7", "tracker", "silent"), ("encoders:slow@1.7,factor=3", "encoders", "slow")],
)
def test_the_state_of_a_device_is_that_of_now_and_not_of_its_last_sample(fault, device, state):
    with open_bench("emulated_floor", faults=[fault]) as bench:
        seen = ToldInTime(bench)
        bench.add_sink(seen)
        bench.observe(2.9, feedback="odometry")
    live = [(data["devices"], t_s) for kind, data, t_s in seen.told if kind == "live"]
    before = [devices for devices, t_s in live if 0.6 < t_s < 1.7]
    after = [devices for devices, t_s in live if t_s > 2.4]
    assert len(before) > 1
    assert len(after) > 1
    assert {told["status"] for devices in before for told in devices.values()} == {"ok"}
    assert {devices[device]["status"] for devices in after} == {state}
    others = [told["status"] for devices in after for name, told in devices.items() if name != device]
    assert set(others) == {"ok"}


def test_a_robot_whose_loop_has_stopped_is_told_as_watched_within_a_second(records):
    """The fan fails while the robot drives up the wall: what is told of it then is not that it drives."""
    with open_bench("emulated", faults=["adhesion:off@4"]) as bench:
        seen = ToldInTime(bench)
        bench.add_sink(seen)
        with pytest.raises(SafetyStop) as stop:
            bench.drive(line((0, 0, 0), (0.3, 0, 0), duration_s=20.0), feedback="odometry")
        stopped_s = bench.clock.now_ns() / 1e9
    after = [(kind, data, t_s) for kind, data, t_s in seen.told if t_s >= stopped_s]
    kind, told, t_s = after[0]
    assert kind == "watched"
    assert t_s < stopped_s + 1.0
    assert str(stop.value) in told["words"]
    assert any("adhesion" in event for event in told["events"])
    assert {kind for kind, _, _ in after} == {"watched", "held"}
    times = [t_s for kind, _, t_s in after if kind == "watched"]
    assert max(b - a for a, b in pairwise(times)) < 1.0


def test_wheels_at_rest_are_told_with_the_time_since_when():
    with open_bench("emulated") as bench:
        seen = ToldInTime(bench)
        bench.add_sink(seen)
        bench.drive(line((0, 0, 0), (0.02, 0, 0), duration_s=2.0), feedback="odometry", hold_s=0.0)
        bench.look()
        rests = [(data["rest_s"], data["why"]) for kind, data, _ in seen.told if kind == "watched"]
    assert rests[0] == (None, ""), "nothing has been seen yet"
    known = [rest_s for rest_s, _ in rests if rest_s is not None]
    assert known
    assert known == sorted(known)


def test_no_pose_is_told_while_one_wheel_turns_alone(records):
    """By odometry of a lifted wheel the robot would seem to drive."""
    reported, clock = [], At()
    stream = StatusStream(lambda kind, data: reported.append(data), clock, BENCH)
    for controller, known in (("jog:drive_FL", False), (None, True)):
        stream.note(0, "run", {"controller": controller})
        clock.ns += nanoseconds(1.0)
        stream.write(records[0])
        stream.rest()
        assert (reported[-1]["pose"] != [None] * 3) == known
        assert (reported[-1]["twist"] != [None] * 3) == known
        assert None not in reported[-1]["wheel_rad_s"]
