"""What clients of others send to the emulated capture server, and which frames each of them gets."""

import struct

import pytest

import hil
from hil.fakes.mocap.natnet.virtual_network import PacketNetwork

CONNECT, REQUEST, KEEPALIVE, FRAME = 0, 2, 10, 7
S = 1_000_000_000
ME = ("127.0.0.1", 5000)


class Network(PacketNetwork):
    """Keeps the frames that go to each address."""

    def __init__(self, groups=()):
        self.groups, self.frames = groups, {}

    def joined(self, group):
        return group in self.groups

    def deliver(self, ready_ns, data, destination):
        if struct.unpack_from("<H", data)[0] == FRAME:
            self.frames.setdefault(destination, []).append(data)


def as_optitrack_sends(kind, command="", *, bitstream=None):
    """OptiTrack's own Python client: one zero more than the size says, and its wishes after 265 bytes."""
    if bitstream is not None:
        command = command.ljust(265, "\0") + "".join(map(chr, (*bitstream, 0, 0))) + "\0"
    size = len(command) + 1 if command else 0
    return struct.pack("<HH", kind, size) + command.encode() + b"\0"


def frames_after(bench, network, *requests, seconds=0.2):
    """How many frames come to the address, and the first of them."""
    for request in requests:
        bench.server.receive(request, ME, network, bench.clock.now_ns())
    bench.clock.sleep_until_ns(bench.clock.now_ns() + round(seconds * S))
    found = network.frames.get(ME, [])
    return len(found), found[0] if found else b""


def test_a_sign_of_life_of_optitracks_client_keeps_its_stream_alive(mocap_bench):
    bench, network = mocap_bench(), Network()
    for _ in range(4):
        count, _ = frames_after(bench, network, as_optitrack_sends(KEEPALIVE), seconds=5.0)
    assert count == pytest.approx(2000, abs=10)
    count, _ = frames_after(bench, network, seconds=15.0)
    assert count == pytest.approx(2500, abs=15), "then it is forgotten"


@pytest.mark.parametrize(("server", "asked", "given"), [((4, 1), (3, 1), (3, 1)), ((4, 0), (4, 1), (4, 0))])
def test_the_bit_stream_of_a_connection_is_the_one_that_it_asks_for(mocap_bench, server, asked, given):
    bench, plain = mocap_bench(version=server), mocap_bench(version=given)
    _, frame = frames_after(bench, Network(), as_optitrack_sends(CONNECT, "Ping", bitstream=asked))
    _, expected = frames_after(plain, Network(), as_optitrack_sends(CONNECT, "Ping", bitstream=given))
    assert frame == expected


def test_a_client_of_the_offered_group_gets_each_frame_once(mocap_bench):
    bench, network = mocap_bench(), Network(groups=("239.255.42.99",))
    bench.server.offered_group = "239.255.42.99"
    bench.server.attach(network)
    count, _ = frames_after(bench, network, as_optitrack_sends(CONNECT, "Ping"))
    assert (count, len(network.frames[("239.255.42.99", bench.server.data_port)])) == (0, 20)
    count, _ = frames_after(bench, network, as_optitrack_sends(KEEPALIVE))
    assert count == 20, "who keeps a stream alive wants one of its own"


def test_where_no_client_has_joined_the_offered_group_a_connection_is_enough(mocap_bench):
    bench, network = mocap_bench(), Network()
    bench.server.offered_group = "239.255.42.99"
    count, _ = frames_after(bench, network, as_optitrack_sends(CONNECT, "Ping"))
    assert count == 20


def test_the_data_port_of_a_host_gets_each_frame_once_however_many_clients_it_had(mocap_bench):
    bench, network = mocap_bench(), Network()
    for port in (5001, 5002):
        bench.server.receive(as_optitrack_sends(CONNECT, "Ping"), ("127.0.0.1", port), network, 0)
    count, first = frames_after(bench, network, as_optitrack_sends(CONNECT, "Ping", bitstream=(3, 1)))
    at_data_port = network.frames[("127.0.0.1", bench.server.data_port)]
    assert (count, len(at_data_port), at_data_port[0]) == (20, 20, first)


def test_the_bench_file_says_which_version_the_server_speaks():
    with hil.open_bench("emulated", overrides={"emulation.mocap.natnet": "3.1"}) as bench:
        assert bench.devices.get("mocap").identity()["natnet"] == "3.1"
