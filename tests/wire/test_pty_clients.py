"""An emulated serial port between its clients: like an adapter's driver it forgets what nobody reads."""

import contextlib
import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from array import array

import pytest
import serial

from hil.core.clock import MonotonicClock
from hil.fakes import pty_clients
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.serial_line import SerialLine
from hil.fakes.serial_pty import SerialPty
from hil.fakes.server import EmulationServer
from hil.fakes.world import World
from tests.still_plant import StillPlant

pytestmark = pytest.mark.real_time
TIOCGEXCL = 0x80045440
CLAIMS = "import fcntl, os, sys, termios, time; p = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY);"
CLAIMS += "fcntl.ioctl(p, termios.TIOCEXCL); print('open', flush=True); time.sleep(60)"


class Counter(SerialChip):
    """Sends the world's time in ms, every 5 ms, and echoes what it hears in brackets."""

    name, supported_faults, due_ns = "counter", {}, 5_000_000

    def next_poll_ns(self):
        return self.due_ns

    def poll(self, t_ns):
        self.due_ns = t_ns + 5_000_000
        return [Reply(t_ns, f"{t_ns // 1_000_000}\n".encode())]

    def receive(self, data, t_ns, baud):
        return [Reply(t_ns, b"<" + data + b">\n")]

    def reset(self, t_ns):
        pass


@pytest.fixture
def port():
    """Path of the terminal at which a counter is served."""
    world = World(StillPlant())
    transport = SerialPty(SerialLine(world, Counter()))
    server = EmulationServer(world, MonotonicClock(), {"counter": transport})
    thread = threading.Thread(target=server.run)
    thread.start()
    yield transport.endpoint()["port"]
    server.stop()
    thread.join(10)


def lines(path, seconds):
    with serial.Serial(path, 115_200, timeout=0.05) as opened:
        end_s, data = time.monotonic() + seconds, b""
        while time.monotonic() < end_s:
            data += opened.read(4096)
    return [int(line) for line in data.split(b"\n")[1:-1]]


def test_a_client_gets_nothing_that_was_sent_before_it_came(port):
    time.sleep(0.5)
    first = lines(port, 0.5)
    time.sleep(1.0)
    second = lines(port, 0.5)
    assert len(first) > 20
    assert len(second) > 20
    assert first[0] > 400
    assert second[0] - first[-1] > 800, "what came meanwhile is discarded"


def test_two_clients_at_once_and_one_that_leaves(port):
    """The kernel reports two openings in a row as one; the second client goes on."""
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(serial.Serial(port, 115_200, timeout=2.0)) for _ in range(3)]
        clients[0].close()
        clients[1].close()
        time.sleep(0.5)
        clients[2].reset_input_buffer()
        clients[2].readline()
        before = int(clients[2].readline())
        time.sleep(0.3)
        clients[2].write(b"x")
        answer = b""
        while not answer.startswith(b"<x>"):
            answer = clients[2].readline()
            assert answer, "it waits in vain"
        assert before > 0


def claimed(path):
    """Whether a program has made the port its own; asked through a descriptor of this process."""
    own = os.open(path, os.O_RDWR | os.O_NOCTTY)
    flag = array("i", [0])
    fcntl.ioctl(own, TIOCGEXCL, flag)
    os.close(own)
    return bool(flag[0])


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGTERM])
def test_a_killed_client_leaves_no_claim_to_be_the_only_one(port, ending):
    """As another client: opening a claimed terminal is refused to all but root."""
    with subprocess.Popen([sys.executable, "-c", CLAIMS, port], stdout=subprocess.PIPE, text=True) as client:
        assert client.stdout.readline() == "open\n"
        client.send_signal(ending)
        client.wait(10)
    end_s = time.monotonic() + 10.0
    while (still := claimed_by_flag(port)) and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not still


def claimed_by_flag(path):
    try:
        return claimed(path)
    except OSError:  # refused, as to an ordinary user
        return True


def test_a_closed_port_leaves_no_thread_that_looks_for_its_clients(monkeypatch):
    """The look that a client's last closing has begun once went on behind the emulator's end."""
    monkeypatch.setattr(pty_clients, "programs_with", lambda path: time.sleep(0.3))
    before = set(threading.enumerate())
    transport = SerialPty(SerialLine(World(StillPlant()), Counter()))
    for _ in range(2):
        with serial.Serial(transport.endpoint()["port"]):
            pass
        for fd in transport.filenos():
            transport.on_readable(fd, 0)
    assert set(threading.enumerate()) > before
    transport.close()
    assert set(threading.enumerate()) == before
