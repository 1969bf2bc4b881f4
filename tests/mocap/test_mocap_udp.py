"""The emulated capture server on UDP: PyPI `natnet`, a client of a few lines, and the driver."""

import contextlib
import os
import socket
import struct
import time
from types import SimpleNamespace

import natnet_builder as build
import numpy as np
import pytest
from natnet import NatNetClient
from natnet.version import Version

from hil.config.mocap import MocapConfig
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.drivers.mocap.natnet.driver import NatNetMocap
from hil.fakes.mocap.natnet.chip import NatNetServer
from hil.fakes.mocap.natnet.udp import NatNetTransport
from hil.fakes.world import World
from hil.links.udp_ports import UdpPort

pytestmark = pytest.mark.real_time

GROUP = f"239.255.42.{1 + os.getpid() % 250}"


def public_client(transport, *, multicast):
    where = transport.endpoint()
    return NatNetClient(
        server_ip_address=where["server"],
        local_ip_address="127.0.0.1",
        multicast_address=where["multicast"] or "239.255.42.99",
        command_port=where["command_port"],
        data_port=where["data_port"],
        use_multicast=multicast,
    )


def until(condition, seconds=5.0):
    """Wait on the kernel's side of things, without sleeping blindly."""
    deadline = time.monotonic() + seconds
    waiter = socket.socketpair()
    with waiter[0], waiter[1]:
        waiter[0].settimeout(0.01)
        while not condition() and time.monotonic() < deadline:
            with contextlib.suppress(TimeoutError):
                waiter[0].recv(1)
    assert condition()


@pytest.mark.parametrize(("version", "multicast"), [((3, 1), False), ((4, 0), True), ((4, 1), False)])
def test_a_public_client_gets_frames_and_definitions(served, version, multicast):
    transport = served(version=version, multicast=GROUP if multicast else None)
    got = SimpleNamespace(frames=[], models=[])
    client = public_client(transport, multicast=multicast)
    client.on_data_frame_received_event.handlers.append(got.frames.append)
    client.on_data_description_received_event.handlers.append(got.models.append)
    with client:
        assert client.server_info.application_name == "Motive"
        assert client.server_info.nat_net_protocol_version == Version(*version)
        client.run_async()
        client.request_modeldef()
        until(lambda: len(got.frames) > 20 and got.models)
    assert {(b.name, b.id_num) for b in got.models[0].rigid_bodies} == {("robot", 1), ("distractor", 2)}
    body = next(b for b in got.frames[-1].rigid_bodies if b.id_num == 1)
    t_s = got.frames[-1].suffix.timestamp - got.frames[0].suffix.timestamp
    first = next(b for b in got.frames[0].rigid_bodies if b.id_num == 1)
    assert body.pos[0] - first.pos[0] == pytest.approx(0.05 * t_s, abs=1e-4)
    assert body.pos[1] == pytest.approx(0.08, abs=1e-5)
    assert body.tracking_valid
    steps = np.diff([f.prefix.frame_number for f in got.frames])
    assert np.all(steps >= 0)


@pytest.mark.parametrize(
    ("version", "multicast"), [((3, 1), None), ((4, 1), GROUP)], ids=["3.1", "4.1 group"]
)
def test_the_driver_reads_over_udp(served, settings_of, version, multicast):
    transport = served(version=version, multicast=multicast)
    driver = NatNetMocap(settings_of(transport), MonotonicClock())
    driver.open()
    try:
        samples = []
        until(lambda: samples.extend(driver.read()) or len(samples) > 30)
        assert all(s.status.value == "ok" for s in samples)
        ages = [s.stamp.host_ns - s.stamp.t_ns for s in samples]
        assert min(ages) > 0
        assert np.all(np.diff([s.stamp.seq for s in samples]) >= 1)
        assert driver.identity()["natnet"] == "{}.{}".format(*version)
    finally:
        driver.close()
    driver.close()


def test_frames_come_to_the_asking_port_and_to_the_data_port(served):
    """Public clients expect either."""
    transport = served()
    where = transport.endpoint()
    server = (where["server"], where["command_port"])
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as command,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as data,
    ):
        command.bind(("127.0.0.1", 0))
        data.bind(("127.0.0.1", where["data_port"]))
        for s in (command, data):
            s.settimeout(3.0)
        command.sendto(build.message(10, b"\0"), server)
        for s in (command, data):
            packet, sender = s.recvfrom(65535)
            assert struct.unpack_from("<HH", packet) == (7, len(packet) - 4)
            assert sender == server
        data.close()
        command.sendto(build.message(9, b"\0"), server)


def ask(transport, *requests):
    """Answers to requests, without frames."""
    where = transport.endpoint()
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        s.settimeout(2.0)
        for request in requests:
            s.sendto(request, (where["server"], where["command_port"]))
            while True:
                packet = s.recvfrom(65535)[0]
                if packet[0] != 7 or request[0] == 6:
                    found.append(packet)
                    break
    return found


def test_what_else_a_client_may_ask(served):
    transport = served()
    rate, unit, stream, unknown, odd = ask(
        transport,
        build.message(2, b"FrameRate\0"),
        build.message(2, b"UnitsToMillimeters\0"),
        build.message(0, b"Ping\0"),
        build.message(2, b"Bitstream,9.9\0"),
        build.message(33, b""),
    )
    assert struct.unpack("<HHf", rate) == (3, 4, 100.0)
    assert struct.unpack("<HHf", unit) == (3, 4, 1000.0)
    assert stream[0] == 1
    assert unknown[:2] == odd[:2] == b"\x64\x00"
    until(lambda: ask(transport, build.message(6, b"\0"))[0][0] == 7)


def test_garbage_and_strangers_do_not_disturb_the_server(served, settings_of):
    transport = served()
    where = transport.endpoint()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        for data in (b"", b"\0", b"\0\0\xff\xff", bytes(range(256)) * 8, build.message(0, b"Ping\0")[:-1]):
            s.sendto(data, (where["server"], where["command_port"]))
    driver = NatNetMocap(settings_of(transport), MonotonicClock())
    driver.open()
    driver.close()


def test_a_stranger_on_the_data_port_does_not_reach_the_loop(served, settings_of):
    transport = served()
    driver = NatNetMocap(settings_of(transport), MonotonicClock())
    driver.open()
    try:
        fake = build.frame((4, 1), 1, [build.body(1, (50.0, 50.0, 50.0))])
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
            s.bind(("127.0.0.1", 0))
            samples = []

            def disturbed():
                s.sendto(fake, ("127.0.0.1", transport.endpoint()["data_port"]))
                s.sendto(b"hello", ("127.0.0.1", transport.endpoint()["data_port"]))
                samples.extend(driver.read())
                return len(samples) > 20

            until(disturbed)
        assert all(abs(s.position_m[0]) < 2 for s in samples)
        assert driver.counts["strangers"] > 0
        assert driver.counts["malformed"] > 0
    finally:
        driver.close()


def test_addresses_that_are_not_ours_are_refused():
    clock = MonotonicClock()
    with pytest.raises(DeviceError, match="UDP ports cannot be used"):
        NatNetMocap(MocapConfig(local_address="203.0.113.7"), clock).open()
    world = World(SimpleNamespace(t_ns=0))
    with pytest.raises(DeviceError, match="cannot be served"):
        NatNetTransport(NatNetServer(world), host="203.0.113.7")


def test_requests_that_cannot_leave_the_host_are_silence():
    config = MocapConfig(server="255.255.255.255", open_timeout_s=0.2)
    with pytest.raises(DeviceTimeoutError, match="no server answers") as caught:
        NatNetMocap(config, MonotonicClock()).open()
    assert caught.value.port == "255.255.255.255:1510"


def test_a_port_that_is_not_read_loses_and_counts():
    port = UdpPort(MonotonicClock(), None, 0, "127.0.0.1")
    try:
        address = port._socket.getsockname()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:

            def flood():
                for _ in range(100):
                    s.sendto(b"x", address)
                return port.overflowed > 0

            until(flood)
    finally:
        port.close()
