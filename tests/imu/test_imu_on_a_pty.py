"""Driver, plain pyserial script and emulated chip across a real pseudo-terminal, in real time."""

import contextlib
import os
import threading
import tty

import pytest
import serial

from hil.config.imu import Bno055Config
from hil.core.clock import MonotonicClock
from hil.core.signals import Status
from hil.drivers.imu.bno055.driver import Bno055Imu
from hil.fakes.imu.bno055.chip import Bno055Chip
from hil.fakes.server import EmulationServer
from hil.fakes.world import NEVER_NS, World

pytestmark = pytest.mark.alone


class PtyTransport:
    """Bytes from the terminal to the chip and back when they are due."""

    def __init__(self, world, chip):
        self.world, self.chip, self.queue = world, chip, []
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)

    def next_due_ns(self):
        return min([self.queue[0].ready_ns if self.queue else NEVER_NS, self.chip.next_poll_ns()])

    def on_due(self, t_ns):
        self.queue += self.chip.poll(t_ns)
        while self.queue and self.queue[0].ready_ns <= t_ns:
            os.write(self.master, self.queue.pop(0).data)

    def filenos(self):
        return [self.master]

    def on_readable(self, fd, t_ns):
        self.world.sync_plant()
        self.queue += self.chip.receive(os.read(fd, 4096), t_ns, 115_200)

    def endpoint(self):
        return {"port": self.path, "baud": 115_200}

    def close(self):
        for fd in (self.master, self.slave):
            with contextlib.suppress(OSError):
                os.close(fd)


@pytest.fixture
def served(turning_plant):
    world = World(turning_plant(rate_rad_s=0.2), seed=1)
    transport = PtyTransport(world, Bno055Chip(world, overrun_probability=0.02))
    server = EmulationServer(world, MonotonicClock(), {"imu": transport})
    thread = threading.Thread(target=server.run)
    thread.start()
    yield transport.path
    server.stop()
    thread.join(10)


def test_the_driver_reads_at_100_hz(served):
    clock = MonotonicClock()
    driver = Bno055Imu(Bno055Config(port=served, reply_timeout_s=0.05), clock)
    driver.open()
    samples, t_ns = [], clock.now_ns()
    for _ in range(60):
        samples += driver.read()
        t_ns += 10_000_000
        clock.sleep_until_ns(t_ns)
    driver.close()
    good = [s for s in samples if s.status is Status.OK]
    assert len(good) > 40
    assert good[-1].gyro_rad_s[2] == pytest.approx(0.2, abs=0.03)


def test_a_plain_pyserial_script_talks_to_the_chip(served):
    with serial.Serial(served, 115_200, timeout=1.0) as port:

        def exchange(text, length):
            port.write(bytes.fromhex(text))
            return port.read(length).hex()

        assert exchange("AA 01 00 04", 6) == "bb04a0fb320f"
        assert exchange("AA 00 3D 01 0C", 2) == "ee01"
        assert exchange("AA 01 3D 01", 3) == "bb010c"
        assert exchange("AA 01 00", 2) == "ee0a"
