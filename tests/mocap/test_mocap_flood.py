"""A flood of datagrams from anybody on this host: bounded work in every read, counted and named."""

import logging
import socket
from types import SimpleNamespace

import natnet_builder as build
import pytest

from hil.config.mocap import MocapConfig
from hil.core.clock import MonotonicClock
from hil.drivers.mocap.natnet.session import Session
from hil.links.udp_ports import _MOST_PER_WINDOW, _WINDOW_NS, Datagram, UdpPort

pytestmark = pytest.mark.alone

SERVER = ("127.0.0.1", 1510)
OTHER = ("127.0.0.1", 4242)
JUNK = {
    "another host": (build.frame((4, 1), 7, [build.body(1)]), ("10.0.0.1", 1510)),
    "nonsense": (b"\xff" * 1400, OTHER),
    "empty": (b"", OTHER),
    "a description": (build.server_info(), OTHER),
    "the same frame": (build.frame((4, 1), 5, [build.body(1)]), SERVER),
}


class Flooded:
    """Two ports on which as much waits as anybody asks for; `taken` counts what was looked at."""

    def __init__(self):
        self.junk, self.taken, self.first = [], 0, []

    def __call__(self, group, port):
        return self

    def send(self, data, address):
        pass

    def receive(self):
        if self.first:
            return Datagram(*self.first.pop(0), 0)
        if not self.junk:
            return None
        self.taken += 1
        return Datagram(*self.junk[self.taken % len(self.junk)], 0)

    def close(self):
        pass


@pytest.mark.parametrize("kinds", [*([kind] for kind in JUNK), list(JUNK)], ids=[*JUNK, "all"])
def test_one_read_looks_at_a_bounded_number_of_useless_datagrams(kinds, caplog):
    ports = Flooded()
    session = Session(MocapConfig(body=1), SimpleNamespace(now_ns=lambda: 0), ports)
    ports.first = [(build.server_info(), SERVER), (build.frame((4, 1), 5, [build.body(1)]), SERVER)]
    assert len(list(session.frames())) == 1
    ports.junk = [JUNK[kind] for kind in kinds]
    with caplog.at_level(logging.WARNING):
        for read in range(1, 4):
            assert list(session.frames()) == []
            assert ports.taken == 256 * read
    assert session.floods == 3
    assert caplog.text.count("another program floods the ports of 127.0.0.1:1510") == 1
    assert session.strangers + session.malformed + session.repeated == ports.taken


def test_second_copies_of_what_was_not_read_for_long_are_no_flood(caplog):
    """A server that knows both ports sends every frame twice; after a pause all of them wait."""
    ports = Flooded()
    session = Session(MocapConfig(body=1), SimpleNamespace(now_ns=lambda: 0), ports)
    copies = [(build.frame((4, 1), number, [build.body(1)]), SERVER) for number in range(5, 605)]
    ports.first = [(build.server_info(), SERVER), *copies, *copies]
    with caplog.at_level(logging.WARNING):
        found = [len(list(session.frames())) for _ in range(5)]
    assert found == [600, 0, 0, 0, 0]
    assert (session.repeated, session.floods, caplog.text) == (600, 0, "")


def test_frames_behind_a_flood_are_found_by_the_following_reads():
    ports = Flooded()
    session = Session(MocapConfig(body=1), SimpleNamespace(now_ns=lambda: 0), ports)
    ports.first = [(build.server_info(), SERVER), *[(b"junk", OTHER)] * 1000]
    ports.first.append((build.frame((4, 1), 5, [build.body(1)]), SERVER))
    found = [len(list(session.frames())) for _ in range(5)]
    assert sum(found) == 1
    assert found[:3] == [0, 0, 0]


def test_a_flood_takes_a_bounded_share_of_the_listener():
    """However fast it comes, so many datagrams in so much time are taken from the kernel."""
    clock = MonotonicClock()
    port = UdpPort(clock, None, 0, "127.0.0.1")
    address = port._socket.getsockname()
    sent = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        begin_ns = clock.now_ns()
        while sent < 60_000:
            sender.sendto(b"x" * 100, address)
            sent += 1
        port.close()
        windows = (clock.now_ns() - begin_ns) / _WINDOW_NS
    assert 0 < port.received <= (windows + 2) * _MOST_PER_WINDOW
    assert port.received < sent
