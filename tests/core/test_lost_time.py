"""Time that this computer takes from loop and emulator: counted, and no device is blamed for it."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from supervised import Supervised
from test_loop_and_server import Standing

import hil
from hil.bench.hold.check_deadline import HoldCheckDeadline
from hil.core.clock import Clock, MonotonicClock
from hil.core.errors import DeviceTimeoutError, SafetyStop
from hil.core.interfaces import Sensor
from hil.core.signals import Inputs, MocapSample, RobotState, ServoSample, Stamp, Status, WheelSetpoint
from hil.loop.alignment import Alignment, AlignmentParameters
from hil.loop.checks.sensor_rate import Healthy
from hil.loop.control_loop import ControlLoop
from hil.loop.device_set import DeviceSet
from hil.loop.pipeline import ControlPipeline
from hil.loop.safety_limits import Checks, SafetyLimits
from hil.loop.supervisor import Supervisor
from hil.procedure.tracking_errors import enable_hold
from hil.support.lost_time import EMULATOR, LOOP, LostTime

MS = 1_000_000
PERIOD_NS = 10 * MS
COUNTED = Path("/proc/thread-self/schedstat")
BUSY = (
    "import os, sys; os.sched_setaffinity(0, {int(sys.argv[1])}); print('on', flush=True)\nwhile True: pass"
)
SERVED = Checks(emulated=frozenset(("servos", "mocap")))


@pytest.fixture
def rival():
    """A busy process on the processor that this thread is bound to; the process id."""
    before = os.sched_getaffinity(0)
    cpu = min(before)
    os.sched_setaffinity(0, {cpu})
    with subprocess.Popen([sys.executable, "-c", BUSY, str(cpu)], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        yield process.pid
        process.kill()
    os.sched_setaffinity(0, before)


def work(seconds):
    end_s = time.thread_time() + seconds
    while time.thread_time() < end_s:
        pass


@pytest.mark.skipif(not COUNTED.exists(), reason="this kernel does not count it")
def test_the_kernel_says_what_a_rival_has_taken_and_what_was_taken_from_it(rival):
    lost = LostTime(MonotonicClock(), [rival])
    assert lost.take() == {}
    began_s = time.monotonic()
    work(0.2)
    took_s = time.monotonic() - began_s
    so_far_ns = lost.so_far_ns()
    found = lost.take()
    assert found[LOOP] == pytest.approx(1e9 * (took_s - 0.2), abs=0.02e9)
    assert 0.1e9 < found[EMULATOR] < 1e9 * took_s * 1.05
    assert so_far_ns == pytest.approx(sum(found.values()), rel=0.1)
    lost.close()
    assert lost.take() == {}


def has_run_ns(pid):
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0])


@pytest.mark.alone
@pytest.mark.skipif(not COUNTED.exists(), reason="this kernel does not count it")
def test_a_wait_that_lasts_is_counted_before_the_process_runs_again(rival):
    """Of two busy processes on one core, one yields to all others: what it does not run, it waits."""
    os.sched_setscheduler(rival, os.SCHED_IDLE, os.sched_param(0))
    lost = LostTime(MonotonicClock(), [rival])
    lost.take()
    seen_ns, began_ns, ran_ns = [], time.monotonic_ns(), has_run_ns(rival)
    while time.monotonic_ns() - began_ns < 0.3e9:
        work(0.02)
        seen_ns.append(lost.take().get(EMULATOR, 0))
    lasted_ns = time.monotonic_ns() - began_ns
    assert min(sorted(seen_ns)[len(seen_ns) // 5 :]) > 0.01e9
    assert sum(seen_ns) == pytest.approx(lasted_ns - (has_run_ns(rival) - ran_ns), abs=0.2 * lasted_ns)


def test_a_process_that_has_ended_loses_nothing():
    process = subprocess.Popen([sys.executable, "-c", ""])
    lost = LostTime(MonotonicClock(), [process.pid])
    lost.take()
    process.wait()
    lost.take()
    assert EMULATOR not in lost.take()


def servos(k, status=Status.OK, **more):
    values, t_ns = np.zeros(8), k * PERIOD_NS
    sample = ServoSample(Stamp(t_ns, t_ns, k), values, values, values, (status,) * 8)
    return Inputs(k, t_ns, servos=(sample,), **more)


def silent(count, lost_ns):
    """A good read, then silent ones, in each of which something was lost."""
    return [servos(0)] + [servos(k, Status.TIMEOUT, lost_ns=lost_ns) for k in range(1, count)]


def stopped(watch, cycles):
    for inputs in cycles:
        try:
            watch.check(inputs)
        except SafetyStop as stop:
            return inputs.cycle, stop
    return None, None


@pytest.mark.parametrize(
    ("checks", "lost_ns", "stops_in"),
    [
        (SERVED, {}, 11),
        (SERVED, {EMULATOR: 5 * MS}, 21),
        (SERVED, {EMULATOR: 3 * MS, LOOP: 2 * MS}, 21),
        (SERVED, {EMULATOR: 20 * MS}, None),
        (Checks(), {EMULATOR: 5 * MS}, 11),
        (Checks(), {LOOP: 5 * MS}, 21),
        (Checks(served=frozenset(("servos",))), {EMULATOR: 5 * MS}, 21),
    ],
)
def test_servos_are_silent_for_the_time_that_was_not_lost(checks, lost_ns, stops_in):
    watch = Supervised(SafetyLimits(), checks=checks)
    found, stop = stopped(watch, silent(60, lost_ns))
    assert found == stops_in
    if stop is not None and checks is SERVED and lost_ns:
        assert stop.reason == "held_up"
        assert "this computer was late by 0.1" in str(stop)
        assert "came in time from: servos" in str(stop)
        assert str(stop).index("from: servos") < str(stop).index("this computer was late"), "the device first"
        assert "check" not in str(stop)
        assert str(stop).count("this computer was late") == 1
    elif stop is not None:
        assert stop.reason == "stale_servos"


def test_a_real_servo_is_blamed_with_what_was_lost_beside():
    _, stop = stopped(Supervised(SafetyLimits()), silent(60, {LOOP: 6 * MS}))
    assert stop.reason == "stale_servos"
    assert "; this computer was late by 0.1" in str(stop)


def test_wheels_wait_also_in_time_that_was_lost():
    watch = Supervised(SafetyLimits(), checks=SERVED)
    for inputs in silent(8, {EMULATOR: PERIOD_NS}):
        watch.check(inputs)
    assert not watch.limit(WheelSetpoint(np.ones(4), np.zeros(4))).wheel_rate_rad_s.any()


def pose(k):
    stamp = Stamp(k * PERIOD_NS, k * PERIOD_NS, k)
    return MocapSample(stamp, np.zeros(3), np.array([1.0, 0, 0, 0]), True, 0.0, 0.0)


@pytest.mark.parametrize("lost_ns", [{}, {EMULATOR: 4 * MS}])
def test_silence_lost_reads_and_rates_are_reported_where_nothing_was_lost(lost_ns):
    """A third of the servos' reads and half of the poses are lost, then no pose comes any more."""
    checks = replace(SERVED, healthy={"mocap": Healthy(100.0, 0.9, 0.1, 100.0)})
    watch = Supervised(SafetyLimits(stale_s={"servos": 0.1, "mocap": 0.5}), checks=checks)
    said = []
    for k in range(400):
        status = Status.TIMEOUT if k % 3 == 0 and k else Status.OK
        seen = (pose(k),) if k % 2 and k < 320 else ()
        inputs = replace(servos(k, status), mocap=seen, lost_ns=lost_ns)
        said += [e.message for e in watch.check(inputs) if e.source in ("servos", "mocap")]
    expected = ("reads are lost", "good samples a second", "stale for")
    assert [any(word in one for one in said) for word in expected] == [not lost_ns] * 3


class Hand(Clock):
    """A clock that moves when it is asked to."""

    t_ns = 0

    def now_ns(self):
        return self.t_ns

    def sleep_until_ns(self, t_ns):
        self.t_ns = max(self.t_ns, t_ns)

    def schedule(self, task, due_ns):
        raise NotImplementedError


class Late(Sensor[MocapSample]):
    """A sensor whose read takes 40 ms, and which then gives up."""

    name = "mocap"

    def __init__(self, clock):
        self.clock, self.reads = clock, 0

    def open(self):
        pass

    def close(self):
        pass

    def identity(self):
        return {}

    def read(self):
        self.clock.t_ns += 40 * MS
        self.reads += 1
        if self.reads > 20:
            raise DeviceTimeoutError("mocap", "nothing usable for 2.0 s")
        return (pose(self.reads),)


class Taken:
    """Says that this computer took so much in each cycle, before and during its read."""

    def __init__(self, before_ns, during_ns):
        self.before_ns, self.during_ns = before_ns, during_ns

    def take(self):
        return {EMULATOR: self.before_ns} if self.before_ns else {}

    def so_far_ns(self):
        return self.during_ns

    def close(self):
        pass


def test_a_slow_read_is_counted_without_what_was_lost_in_it():
    clock = Hand()
    rig = DeviceSet(clock, None, {"mocap": Late(clock)}, Taken(7 * MS, 30 * MS))
    inputs = rig.read(0)
    assert inputs.slow_ns == {"mocap": 10 * MS}
    assert inputs.lost_ns == {EMULATOR: 7 * MS}


@pytest.mark.parametrize(
    ("taken_ns", "expected"),
    [
        (20 * MS, pytest.raises(SafetyStop, match=r"nothing usable.* Meanwhile this computer was late by")),
        (0, pytest.raises(DeviceTimeoutError, match="nothing usable")),
    ],
)
def test_an_emulated_device_that_gives_up_is_not_blamed_while_this_computer_is_late(taken_ns, expected):
    clock = Hand()
    rig = DeviceSet(clock, None, {"mocap": Late(clock)}, Taken(taken_ns, 0))
    supervisor = Supervisor(SafetyLimits(stale_s={}), checks=SERVED)
    pipeline = ControlPipeline(supervisor, Alignment(AlignmentParameters()), Standing(), None)
    pipeline.reset(RobotState(0, np.zeros(3), np.zeros(3), np.eye(6)))
    with expected:
        ControlLoop(rig, clock, pipeline).run(lambda record: False)


def test_a_check_of_the_stopped_robot_waits_for_lost_time_but_not_for_ever():
    time = HoldCheckDeadline(0, 1.0, strict=False)
    time.on_observation(0, doubt=True, waits=False)
    time.on_lost(600 * MS)
    assert not time.is_up(1500 * MS)
    time.on_lost(900 * MS)
    assert not time.is_up(1900 * MS)
    assert time.is_up(2100 * MS)
    strict = HoldCheckDeadline(0, 1.0, strict=True)
    strict.on_lost(600 * MS)
    assert strict.is_up(1100 * MS)


def test_a_fault_of_the_run_is_named_before_a_computer_that_is_late():
    """The servos are switched off by a fault, and the computer is late, too."""
    faults = ["servos:silent@2", "imu:stuck@0.3+0.1", "tracker:off@9"]
    with hil.open_bench("emulated_floor", faults=faults) as bench:
        bench.devices.lost = Taken(5 * MS, 0)
        with pytest.raises(SafetyStop) as stop:
            bench.observe(4.0, feedback="odometry")
        assert stop.value.reason == "held_up"
        said = str(stop.value)
        assert said.startswith(
            "robot stopped (held_up): this run injects servos:silent@2; nothing that can be"
        )
        assert said.index("from: servos") < said.index("this computer was late")
        assert bench.stopped_by == said
        assert stop.value.suspects == ()


@pytest.mark.parametrize("taken_ns", [0, 5 * MS])
def test_what_this_computer_lost_is_told_beside_servos_that_hold_nothing(taken_ns):
    with hil.open_bench("emulated", faults=["servos:silent@3"]) as bench:
        enable_hold(bench)
        bench.devices.lost = Taken(taken_ns, 0)
        bench.clock.sleep_until_ns(round(3.1e9))
        held = bench.look()
    assert held.state == "NOT HELD"
    assert "no servo answers" in held.why
    assert ("this computer was late by" in held.why) is bool(taken_ns)
