"""World time of a bench's own emulator: it stands still until the bench opens its devices."""

import os
import socket

import numpy as np
import pytest
from still_plant import StillPlant

import hil
from hil.core.clock import MonotonicClock
from hil.fakes.server import EmulationServer, Transport
from hil.fakes.world import NEVER_NS, World
from tests.patience import FANLESS

pytestmark = pytest.mark.usefixtures("warm_commands")

SECOND = 1_000_000_000


class Deaf(Transport):
    def __init__(self):
        self.near, self.far = socket.socketpair()
        self.reported_ns = []

    def filenos(self):
        return [self.near.fileno()]

    def on_readable(self, fd, t_ns):
        os.read(fd, 10)
        self.reported_ns.append(t_ns)

    def next_due_ns(self):
        return NEVER_NS

    def on_due(self, t_ns):
        raise AssertionError("nothing is due here")

    def endpoint(self):
        return {}

    def close(self):
        self.near.close()
        self.far.close()


def test_world_time_waits_for_the_bench_and_ends_with_it():
    reads, writes = os.pipe()
    transport, clock = Deaf(), MonotonicClock()
    server = EmulationServer(
        World(StillPlant()), clock, {"deaf": transport}, lifeline=reads, await_start=True
    )
    begun_ns = server.world.now_ns
    transport.far.send(b"?")
    server.step()
    server.step()
    assert transport.reported_ns == [begun_ns]
    assert server.world.now_ns == begun_ns
    os.write(writes, b"\n")
    server.step()
    before_ns = clock.now_ns()
    server.step()
    assert begun_ns < server.world.now_ns < begun_ns + clock.now_ns() - before_ns + SECOND
    os.close(writes)
    server.run()
    os.close(reads)


def test_a_bench_that_opens_late_finds_the_robot_where_it_was_put():
    """Half a second without torque costs millimetres, the seconds before it cost nothing."""
    bench = hil.open_bench("emulated", seed=1, realtime=True, overrides=FANLESS)
    bench.clock.sleep_until_ns(bench.clock.now_ns() + SECOND)
    with bench:
        bench.devices.actuators().enable()
        pose = bench.settle()
    assert np.hypot(*pose[:2]) < 0.1


def test_what_waited_while_the_bench_opened_and_paused_is_no_restart(caplog):
    """Sensors' data pile up before the first cycle and between two runs; asked ahead at 200 Hz, too."""
    overrides = {**FANLESS, "loop.rate_hz": 200.0, "servos.prefetch": True}
    with hil.open_bench("emulated", seed=1, realtime=True, overrides=overrides) as bench:
        bench.devices.actuators().enable()
        for _ in range(2):
            bench.clock.sleep_until_ns(bench.clock.now_ns() + SECOND)
            motion = bench.observe(0.5)
    assert "restarted" not in caplog.text
    encoders = [e for r in motion.records for e in r.inputs.encoders]
    sequences = [e.stamp.seq for e in encoders]
    assert np.all(np.diff(sequences) == 1)
    assert sum(r.inputs.servos[0].ok for r in motion.records) > 0.5 * len(motion.records)
