"""At standard ports the devices of one CAN bus are on one: as a client and another emulator find it."""

import contextlib
import errno
import subprocess
import sys
import threading

import can
import pytest

from hil.bench import open_emulation
from hil.config.loading import load_bench
from hil.core.errors import DeviceError
from hil.fakes import emulated_can_group
from hil.fakes.free_port import free_udp_port
from hil.fakes.mocap.natnet.udp import _cannot_serve

NAMES = ("encoders", "adhesion", "load_cells")
PING_TO_ALL = can.Message(arbitration_id=0x11FF, data=b"\xfe", is_extended_id=True)


@pytest.fixture
def first_port(monkeypatch):
    """Instead of python-can's, which another program of this host may have."""
    port = free_udp_port()
    monkeypatch.setattr(emulated_can_group, "DEFAULT_PORT", port)
    return port


@contextlib.contextmanager
def emulation(**overrides):
    server = open_emulation(
        load_bench("emulated", overrides=overrides), only=NAMES, seed=1, standard_ports=True
    )
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield {kind: endpoint["port"] for kind, endpoint in server.endpoints().items()}
    finally:
        server.stop()
        thread.join(10)


def heard(port, wanted):
    """Identifiers that a client hears who asks for VESCs, until all that are wanted are among them."""
    found, where = set(), {"channel": emulated_can_group.DEFAULT_GROUP, "port": port, "hop_limit": 0}
    with can.Bus(interface="udp_multicast", **where) as bus:
        for count in range(4000):
            if count % 400 == 0:
                bus.send(PING_TO_ALL)
            message = bus.recv(0.01)
            if message is not None:
                found.add(message.arbitration_id)
            if wanted <= found:
                break
    return found


def test_encoders_fan_and_load_cells_of_one_bus_are_heard_at_one_port(first_port):
    with emulation() as ports:
        assert set(ports.values()) == {first_port}
        wanted = {0x1A0, 0x1B0, 0x12FE}  # the encoders' frame, the cells', and the controller's answer
        assert heard(first_port, wanted) >= wanted
    assert emulated_can_group._HELD == {}


def test_a_device_on_another_bus_has_the_next_port(first_port):
    with emulation(**{"load_cells.channel": "can1"}) as ports:
        assert ports == {"can": first_port, "adhesion": first_port, "load_cells": first_port + 1}


HOLDER = """import socket, sys
kind, place = (socket.AF_UNIX, "\\0hil-can-" + sys.argv[2]) if sys.argv[1] == "can" else (
    socket.AF_INET, ("127.0.0.1", int(sys.argv[2])))
held = socket.socket(kind, socket.SOCK_DGRAM)
held.bind(place)
print(flush=True)
sys.stdin.read()
"""


@contextlib.contextmanager
def held_elsewhere(what, port):
    """A port that another program has; gives its process ID."""
    command = [sys.executable, "-c", HOLDER, what, str(port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        other.stdout.readline()
        yield other.pid


def test_the_program_that_has_the_port_of_the_bus_is_named(first_port):
    with held_elsewhere("can", first_port) as pid:
        with (
            pytest.raises(DeviceError, match=rf"\(process {pid}\) of this computer serves CAN") as caught,
            emulation(),
        ):
            pass
        assert str(first_port) in caught.value.expected


def test_the_program_that_has_the_port_of_the_capture_server_is_named():
    port = free_udp_port("127.0.0.1")
    with held_elsewhere("udp", port) as pid:
        said = _cannot_serve("mocap", "127.0.0.1", port, OSError(errno.EADDRINUSE, "in use")).remedy
        assert f"(process {pid}) (kill {pid}), or choose another mocap.command_port" in said
