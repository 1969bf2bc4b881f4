"""Figures for a program that watches: now and then, as JSON has them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from hil.bench import open_bench
from hil.config.loading import load_bench
from hil.core.clock import Clock, nanoseconds
from hil.core.interfaces import Sink
from hil.core.signals import Event
from hil.monitor.status_stream import StatusStream


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
    assert [kind for kind, _ in reported] == ["live"] * 3
    assert [round(data["t_s"], 3) for _, data in reported][:2] == [0.0, 0.04]
    stream.close()
    clock.ns += nanoseconds(1.0)
    stream.write(records[9])
    assert reported[-1][1]["t_s"] == 0.0  # a bench that is opened again has a time of its own
    came = sum(len(r.inputs.servos) for r in records[1:5])
    servos = reported[1][1]["devices"]["servos"]
    assert (servos["samples"], servos["status"], servos["due_hz"]) == (came, "ok", 100.0)
    assert servos["rate_hz"] == pytest.approx(100.0, rel=0.3)
    assert abs(servos["age_ms"]) < 10.0
    shown = servos["values"]["Servo angles (rad)"]
    seen = [s for r in records[:5] for s in r.inputs.servos][-1]
    assert list(shown.values()) == pytest.approx(seen.position_rad.tolist(), rel=1e-4, abs=1e-6)


def test_every_device_of_the_bench_is_there_with_values_or_as_one_that_sent_nothing(records):
    reported, clock = [], At()
    stream = StatusStream(lambda kind, data: reported.append(data), clock, BENCH)
    stream.write(replace(records[0], inputs=replace(records[0].inputs, imu=(), mocap=())))
    for record in records:
        stream.write(record)
    clock.ns = nanoseconds(1.0)
    stream.write(records[-1])
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
    clock.ns = nanoseconds(1.0)
    stream.write(first)
    assert json.loads(json.dumps(reported[0], allow_nan=False))["pose"] == [None, 0.1, 0.2]
    assert [figures["events"] for figures in reported] == [["0.00 s, warning, imu: stuck"]] * 2


def test_how_the_robot_was_left_is_passed_on_and_nothing_else_that_is_noted(records):
    reported = []
    stream = StatusStream(lambda kind, data: reported.append((kind, data)), At(), BENCH)
    stream.note(0, "run", {})
    stream.note(0, "held", {"state": "HELD"})
    assert reported == [("held", {"state": "HELD"})]
