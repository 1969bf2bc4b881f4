"""The multicast bus of one host: speaks with python-can's own, and hears no other host."""

import socket
import time

import can
import pytest
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.utils import pack_message

from hil.config.encoders import EncodersConfig
from hil.fakes.free_port import free_udp_port
from hil.links.can_interface import open_bus
from hil.support import local_can_multicast
from hil.support.emulated_can_mark import Mark, bus_name
from hil.support.local_can_multicast import HostMulticastBus, is_of_this_host

GROUP, STRANGER = "239.74.164.10", "127.0.0.2"
FRAME = can.Message(arbitration_id=0x123, data=b"\x01\x02", is_extended_id=False)


@pytest.fixture
def port():
    return free_udp_port()


@pytest.fixture
def bus(port):
    with HostMulticastBus(GROUP, port) as bus:
        yield bus


def send_from(address, to, data):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.bind((address, 0))
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(address))
        out.sendto(data, to)


def test_it_speaks_with_python_cans_own_bus(bus, port):
    with can.Bus(interface="udp_multicast", channel=GROUP, port=port, hop_limit=0) as own:
        for sender, hearer in ((own, bus), (bus, own)):
            sender.send(FRAME)
            heard = hearer.recv(1.0)
            assert (heard.arbitration_id, bytes(heard.data), heard.is_extended_id) == (
                0x123,
                b"\x01\x02",
                False,
            )
            assert abs(heard.timestamp - time.time()) < 0.5
            assert sender.recv(1.0).arbitration_id == 0x123, "multicast hears itself"
    assert bus.recv(0) is None


def test_it_is_bound_to_the_group_and_takes_no_datagram_that_is_sent_to_the_host(bus, port):
    assert bus._socket.getsockname() == (GROUP, port)
    send_from("127.0.0.1", ("127.0.0.1", port), pack_message(FRAME))
    assert bus.recv(0.2) is None


def test_frames_of_another_host_are_dropped_and_hide_none_of_this_one(bus, port, monkeypatch):
    monkeypatch.setattr(local_can_multicast, "is_of_this_host", lambda sender: sender[0] != STRANGER)
    theirs = pack_message(can.Message(arbitration_id=0x7FF, is_extended_id=False))
    for _ in range(2 * local_can_multicast._MOST_STRANGERS):
        send_from(STRANGER, (GROUP, port), theirs)
    bus.send(FRAME)
    assert bus.recv(0) is None, "one look has an end"
    assert bus.recv(1.0).arbitration_id == 0x123
    send_from(STRANGER, (GROUP, port), theirs)
    began_s = time.monotonic()
    assert bus.recv(0.2) is None
    assert time.monotonic() - began_s >= 0.19, "a stranger shortens no wait"


def test_whose_an_address_is():
    assert is_of_this_host(("127.0.0.1", 9))
    assert is_of_this_host(("::1", 9, 0, 0))
    assert not is_of_this_host(("198.51.100.7", 9))
    assert not is_of_this_host(("255.255.255.255", 9))


def test_this_hosts_own_address_on_its_network_is_its_own():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("198.51.100.7", 9))
        except OSError:
            pytest.skip("this host is on no network")
        assert is_of_this_host(probe.getsockname())


def test_what_is_no_frame_is_reported_as_python_can_does(bus, port):
    for data in (b"", b"nonsense", b"\x81\xa1a\x01"):
        send_from("127.0.0.1", (GROUP, port), data)
        with pytest.raises(can.CanOperationError, match="no CAN frame"):
            bus.recv(1.0)


def test_a_group_that_is_none_is_refused_and_nothing_is_left_open(caplog):
    with pytest.raises(can.CanInitializationError, match=r"198\.51\.100\.7 cannot be joined at port 4711"):
        HostMulticastBus("198.51.100.7", 4711)
    assert "shut down" not in caplog.text


def test_a_bus_that_is_shut_down_says_so(port):
    bus = HostMulticastBus(GROUP, port)
    bus.shutdown()
    bus.shutdown()
    assert bus.fileno() == -1
    with pytest.raises(can.CanOperationError):
        bus.recv(0)
    with pytest.raises(can.CanOperationError):
        bus.send(FRAME)


def test_a_driver_takes_it_for_a_bus_of_this_host_only(port):
    def opened(**options):
        table = EncodersConfig(interface="udp_multicast", channel=GROUP, options={"port": port, **options})
        with open_bus("encoders", table) as bus:
            return type(bus)

    assert opened(hop_limit=0) is HostMulticastBus
    assert opened() is UdpMulticastBus, "devices of other hosts may be there"
    mark = Mark(bus_name("udp_multicast", GROUP, {"port": port}), EncodersConfig().bitrate)
    assert opened() is HostMulticastBus, "emulated here"
    mark.close()
