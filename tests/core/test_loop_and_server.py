"""The loop keeps its grid and always leaves the robot held; the server serves on time; motions as arrays."""

import os
import socket
from dataclasses import replace

import numpy as np
import pytest

from hil.core.clock import MonotonicClock, nanoseconds
from hil.core.errors import DeviceError, RecordingError, SafetyStop
from hil.core.interfaces import Actuators, Controller, Estimator, Sensor, Sink
from hil.core.signals import (
    MocapSample,
    Reference,
    RobotState,
    ServoHold,
    ServoSample,
    Stamp,
    Status,
    WheelSetpoint,
)
from hil.fakes.server import EmulationServer, Transport
from hil.fakes.world import NEVER_NS, VirtualClock, World
from hil.loop.alignment import Alignment, AlignmentParameters
from hil.loop.control_loop import ControlLoop
from hil.loop.cycle_data import Check
from hil.loop.device_set import DeviceSet
from hil.loop.driven_motion import Motion
from hil.loop.pipeline import ControlPipeline
from hil.loop.safety_limits import Checks, SafetyLimits
from hil.loop.supervisor import Supervisor
from hil.replay.difference_limits import Agreement
from hil.replay.verification import verify_cycle
from tests.still_plant import StillPlant


class Servos(Actuators):
    """Eight servos that answer at once; `held` and `commands` tell what was asked of them."""

    name = "servos"

    def __init__(self, clock, silent_after_ns=NEVER_NS):
        self.clock, self.silent_after_ns = clock, silent_after_ns
        self.commands, self.held, self.opened, self.seq = [], False, False, 0

    def open(self):
        self.opened = True

    def close(self):
        self.opened = False

    def identity(self):
        return {"model": "test"} if self.opened else {}

    def ask(self):
        self.asked_ns = self.clock.now_ns()

    def read(self):
        t = self.clock.now_ns()
        ok = t < self.silent_after_ns
        self.seq += 1
        status = (Status.OK if ok else Status.TIMEOUT,) * 8
        values = np.zeros(8) if ok else np.full(8, np.nan)
        return (ServoSample(Stamp(t, t, self.seq), values, values, values, status),)

    def read_health(self):
        return ()

    def enable(self):
        self.held = False

    def command(self, setpoint):
        self.commands.append(setpoint)
        self.held = False

    def stop(self):
        self.held = True

    def look_after(self):
        self.held = True
        return ServoHold(self.clock.now_ns(), np.zeros(8), True)

    def release(self):
        self.held = False


class Mocap(Sensor[MocapSample]):
    name = "mocap"

    def __init__(self, clock, broken=False):
        self.clock, self.broken, self.opened = clock, broken, False

    def open(self):
        if self.broken:
            raise DeviceError("mocap", "no answer")
        self.opened = True

    def close(self):
        self.opened = False

    def identity(self):
        return {}

    def read(self):
        t = self.clock.now_ns()
        position = np.array([1e-9 * t, 0.0, 0.0])
        return (MocapSample(Stamp(t, t, 0), position, np.array([1.0, 0, 0, 0]), True, 0.0, 0.0),)


class Standing(Estimator):
    def reset(self, state):
        self.state = state

    def update(self, measurements):
        return RobotState(measurements.t_ns, self.state.pose_body_in_wall, np.zeros(3), np.eye(6))


class Forward(Controller):
    def reset(self):
        pass

    def update(self, state, reference, wheels):
        return WheelSetpoint(np.ones(4), wheels.steering_rad)


class Busy(Sink):
    """Takes up virtual time in one cycle, as a slow disk would."""

    def __init__(self, clock, at, delay_ns):
        self.clock, self.at, self.delay_ns, self.seen = clock, at, delay_ns, []

    def write(self, record):
        self.seen.append(record)
        if record.cycle == self.at:
            self.clock.sleep_until_ns(self.clock.now_ns() + self.delay_ns)

    def close(self):
        pass


def make(silent_after_ns=NEVER_NS, sinks=lambda clock: (), added=()):
    clock = VirtualClock(World(StillPlant()))
    rig = DeviceSet(clock, servos=Servos(clock, silent_after_ns), sensors={"mocap": Mocap(clock)})
    pipeline = ControlPipeline(
        Supervisor(SafetyLimits(), checks=Checks(added={"servos": added})),
        Alignment(AlignmentParameters()),
        Standing(),
        Forward(),
        lambda t_s: Reference(t_s, np.zeros(3), np.zeros(3), np.zeros(3)),
        {"shadow": Standing()},
    )
    pipeline.reset(RobotState(0, np.zeros(3), np.zeros(3), np.eye(6)))
    return rig, ControlLoop(rig, clock, pipeline, sinks=sinks(clock))


def test_cycles_fall_on_the_grid_and_the_robot_is_held_at_the_end():
    records = []
    rig, loop = make()
    loop.run(lambda r: (records.append(r), r.cycle == 50)[1])
    assert [r.deadline_ns for r in records] == [k * 10_000_000 for k in range(51)]
    assert rig.servos.held
    assert len(rig.servos.commands) == 51
    assert loop.statistics.summary()["late"] == 0
    motion = Motion(tuple(records))
    np.testing.assert_allclose(motion.t_s, np.arange(51) * 0.01)
    np.testing.assert_allclose(motion.mocap[:, 0], motion.t_s, atol=1e-12)
    np.testing.assert_array_equal(motion.observer("shadow"), np.zeros((51, 3)))
    np.testing.assert_array_equal(motion.estimate, motion.reference)
    assert motion.wheels.shape == (51, 8)
    assert motion.covariance.shape == (51, 6, 6)
    assert np.all(np.isnan(motion.diagnostic("nothing")))
    assert (motion.twist == 0).all()
    assert motion.events == ()


def test_sinks_are_called_when_the_loop_sleeps_after_every_cycle_and_at_the_end():
    reported = []

    class Resting(Busy):
        def rest(self):
            reported.append((len(self.seen), self.clock.now_ns()))

    def until(record):
        if record.cycle == 3:
            raise RuntimeError("enough")
        return False

    _, loop = make(sinks=lambda clock: (Resting(clock, 1, nanoseconds(0.004)),))
    with pytest.raises(RuntimeError, match="enough"):
        loop.run(until)
    assert reported == [(1, 0), (2, 14_000_000), (3, 20_000_000), (4, 30_000_000)]


def test_a_missed_deadline_is_counted_and_never_made_up_for():
    starts = []
    _, loop = make(sinks=lambda clock: (Busy(clock, 3, nanoseconds(0.037)),))
    loop.run(lambda r: (starts.append(r.start_ns), r.cycle == 6)[1])
    assert starts == [0, 10_000_000, 20_000_000, 30_000_000, 67_000_000, 70_000_000, 80_000_000]
    assert loop.statistics.late == 1
    assert loop.statistics.skipped == 2


def test_silent_servos_stop_the_robot_and_leave_a_record_of_why():
    rig, loop = make(silent_after_ns=nanoseconds(0.2), sinks=lambda clock: (Busy(clock, -1, 0),))
    with pytest.raises(SafetyStop, match="stale_servos"):
        loop.run(lambda r: False)
    assert rig.servos.held
    assert "stale_servos" in loop.sinks[0].seen[-1].events[0].message


class Slack(Check):
    """Measures a rope in every cycle, and stops where it is slack."""

    def on_samples(self, cycle):
        cycle.diagnostics["rope_n"] = force_n = 20.0 - cycle.inputs.cycle
        if force_n < 15.0:
            cycle.stop("slack", "the rope is slack")


def test_the_record_of_a_stop_keeps_what_the_checks_measured_and_verifies_with_and_without():
    _, loop = make(sinks=lambda clock: (Busy(clock, -1, 0),), added=(Slack(),))
    with pytest.raises(SafetyStop, match="slack"):
        loop.run(lambda r: False)
    records = loop.sinks[0].seen
    assert [r.state.diagnostics["rope_n"] for r in records] == [20.0, 19.0, 18.0, 17.0, 16.0, 15.0, 14.0]
    bare = replace(records[-1], state=replace(records[-1].state, diagnostics={}))
    for last in (records[-1], bare):
        loop.pipeline.reset(RobotState(0, np.zeros(3), np.zeros(3), np.eye(6)))
        for record in (*records[:-1], last):
            assert verify_cycle(record, loop.pipeline, Agreement(), exact=True) == ("identical", "")


def test_a_run_that_was_ended_from_outside_has_no_figures_of_the_cycle_before():
    class Full(Busy):
        def objection(self):
            return RecordingError("disk", "is full") if len(self.seen) == 2 else None

    _, loop = make(sinks=lambda clock: (Full(clock, -1, 0),), added=(Slack(),))
    with pytest.raises(RecordingError):
        loop.run(lambda r: False)
    assert [dict(r.state.diagnostics) for r in loop.sinks[0].seen] == [{"rope_n": 20.0}, {"rope_n": 19.0}, {}]


def test_an_error_in_the_callers_code_still_holds_the_robot():
    rig, loop = make()
    with pytest.raises(ZeroDivisionError):
        loop.run(lambda r: 1 / 0)
    assert rig.servos.held


def test_a_rig_that_cannot_open_whole_closes_what_it_opened():
    clock = MonotonicClock()
    rig = DeviceSet(clock, servos=Servos(clock), sensors={"mocap": Mocap(clock)})
    rig.open()
    assert rig.servos.opened
    rig.close()
    assert not rig.servos.opened
    rig.get("mocap").broken = True
    with pytest.raises(DeviceError, match="no answer"):
        rig.open()
    assert not rig.servos.opened
    with pytest.raises(DeviceError, match="no servos"):
        DeviceSet(clock).actuators()


class Echo(Transport):
    """Answers a byte with the world time at which it was served; ticks every 5 ms."""

    def __init__(self):
        self.near, self.far = socket.socketpair()
        self.due_ns, self.ticks, self.closed = 5_000_000, 0, False

    def filenos(self):
        return [self.near.fileno()]

    def on_readable(self, fd, t_ns):
        os.read(fd, 1)
        self.near.send(str(t_ns).encode())

    def next_due_ns(self):
        return self.due_ns

    def on_due(self, t_ns):
        self.ticks += 1
        self.due_ns += 5_000_000

    def endpoint(self):
        return {"fd": self.far.fileno()}

    def close(self):
        self.near.close()
        self.closed = True


@pytest.mark.alone
def test_the_server_answers_and_ticks_on_world_time():
    transport = Echo()
    server = EmulationServer(World(StillPlant()), MonotonicClock(), {"echo": transport})
    assert server.endpoints() == {"echo": {"fd": transport.far.fileno()}}
    transport.far.send(b"?")
    while transport.ticks < 4:
        server.step()
    assert 0 <= int(transport.far.recv(32)) <= server.world.now_ns
    assert transport.ticks == server.world.now_ns // 5_000_000
    server.stop()
    server.run()
    assert transport.closed
    transport.far.close()


class Listener(Transport):
    """Notes when it takes each byte of a pipe, as a controller does that lets go after too long a silence."""

    def __init__(self):
        self.read_end, self.write_end = os.pipe()
        self.taken_ns = []

    def next_due_ns(self):
        return NEVER_NS

    def on_due(self, t_ns):
        raise AssertionError

    def filenos(self):
        return [self.read_end]

    def on_readable(self, fd, t_ns):
        os.read(fd, 1)
        self.taken_ns.append(t_ns)

    def endpoint(self):
        return {}

    def close(self):
        os.close(self.read_end)
        os.close(self.write_end)


class JumpingClock(MonotonicClock):
    """Stands still but for jumps, as for a process that gets no processor time."""

    t_ns = 0

    def now_ns(self):
        return self.t_ns


def test_an_emulator_that_was_starved_hears_what_came_meanwhile_before_its_time_is_over():
    """200 commands of 4 s: taken at once, or none before the end, they would leave 4 s of silence."""
    clock, transport = JumpingClock(), Listener()
    server = EmulationServer(World(StillPlant()), clock, {"fan": transport})
    begin_ns = server.world.now_ns
    os.write(transport.write_end, bytes(200))
    clock.t_ns += nanoseconds(4.0)
    while server.world.now_ns < begin_ns + nanoseconds(4.0):
        server.step()
    server.close()
    silence_ns = np.diff([begin_ns, *transport.taken_ns, begin_ns + nanoseconds(4.0)])
    assert silence_ns.max() <= nanoseconds(0.05)


class Speaker(Echo):
    """Notes, at each tick, whether it was informed that the world is far behind."""

    def __init__(self):
        super().__init__()
        self.reported = []

    def on_due(self, t_ns):
        super().on_due(t_ns)
        self.reported.append(self.behind)


def test_devices_are_informed_while_the_world_is_far_behind():
    """What a chip says of the past would be taken for the present."""
    clock, transport = JumpingClock(), Speaker()
    server = EmulationServer(World(StillPlant()), clock, {"echo": transport})
    clock.t_ns += nanoseconds(0.04)
    while server.world.now_ns < nanoseconds(0.04):
        server.step()
    assert set(transport.reported) == {False}
    transport.reported.clear()
    clock.t_ns += nanoseconds(0.3)
    while server.world.now_ns < nanoseconds(0.34):
        server.step()
    clock.t_ns += nanoseconds(0.01)
    server.step()
    server.close()
    transport.far.close()
    late = transport.reported.count(True)
    assert transport.reported == [True] * late + [False] * (len(transport.reported) - late)
    assert 0.2 <= late * 0.005 <= 0.25


def test_a_world_in_which_nothing_is_planned_keeps_up_with_the_clock():
    transport = Listener()
    clock = MonotonicClock()
    server = EmulationServer(World(StillPlant()), clock, {"fan": transport})
    begin_ns, world_ns = clock.now_ns(), server.world.now_ns
    while clock.now_ns() < begin_ns + nanoseconds(0.25):
        server.step()
    server.close()
    assert server.world.now_ns - world_ns > nanoseconds(0.2)
