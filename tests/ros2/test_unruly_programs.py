"""Programs on ROS 2 that are paused, hurried or slow, in lockstep on the wall."""

import signal
import threading

import numpy as np
import pytest

from hil.core.errors import SafetyStop
from hil.core.interfaces import Sink
from hil.procedure.bench_source import BenchSource
from hil.robot.trajectories import line
from tests.ros2.test_lockstep import FOLLOWS, TOPIC, driver

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
from hil.ros2.network import Network
from hil.ros2.publisher import Ros2Publisher

pytestmark = pytest.mark.timeout(300)
PAUSED_AT = 30
RATE_RAD_S = 0.3
ROLLS = {"stamp": "none", "velocity": [RATE_RAD_S] * 4}


class At(Sink):
    """Does something once so many cycles with a command are over."""

    def __init__(self, cycles, does):
        self._left, self._does = cycles, does

    def write(self, record):
        self._left -= record.external is not None and bool(record.external.commands)
        if self._left == 0:
            self._left = -1
            self._does()

    def close(self):
        pass


def drive(domain, sinks=(), *, answer_s=20.0, duration_s=0.5):
    """The bench, closed, and the records of a motion; raises what ended it."""
    publisher = Ros2Publisher(Network(domain), TOPIC)
    waits = {"ros2.answer_timeout_s": answer_s, "ros2.start_timeout_s": 60.0}
    source = BenchSource("emulated", controller=f"ros2:{TOPIC}", publish=publisher.sink, overrides=waits)
    bench, records, raised = source.open(), (), None
    try:
        with bench:
            for sink in sinks:
                bench.add_sink(sink)
            start = bench.settle()
            way = line(start, start + np.array([0.001, 0, 0]), duration_s=duration_s)
            try:
                records = bench.drive(way, start_pose=start, hold_s=0.1).records
            except SafetyStop as stop:
                raised = stop
    finally:
        publisher.close()
    return bench, records, raised


def rates(records):
    commanded = np.array([record.setpoint.wheel_rate_rad_s for record in records])
    return commanded[np.flatnonzero(commanded.any(axis=1))[0] :]


def test_one_that_is_paused_stops_the_robot_by_name_and_it_is_held(domain):
    with driver(domain, FOLLOWS) as program:
        stops = At(PAUSED_AT, lambda: program.send_signal(signal.SIGSTOP))
        bench, _, stop = drive(domain, [stops], answer_s=0.5)
    assert stop is not None
    assert stop.reason == "ros2_lockstep"
    assert bench.held.state == "HELD"


def test_the_bench_waits_for_one_that_is_paused_for_less_than_its_time(domain):
    with driver(domain, FOLLOWS) as program:

        def pause():
            program.send_signal(signal.SIGSTOP)
            threading.Timer(0.5, program.send_signal, [signal.SIGCONT]).start()

        bench, records, stop = drive(domain, [At(PAUSED_AT, pause)])
    assert stop is None
    assert len(records) > PAUSED_AT
    assert bench.held.state == "HELD"


@pytest.mark.parametrize("rate_hz", [1000, 5])
def test_one_that_sends_more_or_less_often_than_the_loop_gives_one_command_to_each_cycle(rate_hz, domain):
    with driver(domain, {**ROLLS, "on": rate_hz}):
        bench, records, stop = drive(domain, duration_s=0.2)
    assert stop is None
    assert {len(r.external.commands) for r in records if r.external is not None} == {1}
    np.testing.assert_array_equal(np.unique(rates(records)), [RATE_RAD_S])
    assert bench.held.state == "HELD"
