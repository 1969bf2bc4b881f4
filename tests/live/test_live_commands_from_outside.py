"""Velocity commands by UDP: only who knows the token is heard, and a flood costs a bounded piece of work."""

import logging
import socket

import numpy as np
import pytest

from hil.core.errors import UsageError
from hil.live import VelocityReference, open_commands
from hil.live.velocity_input import TOKEN_VARIABLE, UdpLines
from hil.robot.motion_limits import MotionLimits

TOKEN = "0123456789abcdef"


@pytest.fixture
def port():
    """Commands that wait at a port, and how to send to it."""
    lines = UdpLines(0, TOKEN)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    yield lines, lambda data: sender.sendto(data, ("127.0.0.1", lines.port))
    sender.close()
    lines.close()


@pytest.mark.parametrize(
    "data",
    [b"v 1 0 0", b"", b"0123456789abcdeF v 1 0 0", b"0123456789abcdefv 1 0 0", b"\n0123456789abcdef v 1 0 0"],
)
def test_a_datagram_without_the_token_is_refused_counted_and_named(port, data, caplog):
    lines, send = port
    with caplog.at_level(logging.WARNING):
        for _ in range(20):
            send(data)
        assert lines.pending() == []
    assert lines.counts() == {"without_token": 20, "dropped": 0}
    assert 1 <= len(caplog.records) <= 5
    assert "without the token" in caplog.text
    assert TOKEN not in caplog.text


def test_a_datagram_with_the_token_carries_lines(port):
    lines, send = port
    send(f"{TOKEN} v 1 0 0\nstop\n".encode())
    send(f"{TOKEN} stop".encode())
    assert lines.pending() == ["v 1 0 0", "stop", "stop"]


def test_a_robot_obeys_the_token_only(port):
    lines, send = port
    limits = MotionLimits(1.0, 10.0, None)
    reference = VelocityReference(lines, np.zeros(3), np.tile(np.eye(3)[:2], (4, 1)), limits)
    for k in range(100):
        send(b"v 0.5 0 0")
        reference(0.01 * k)
    assert not reference(1.0).pose_in_wall.any()
    for k in range(100):
        send(f"{TOKEN} v 0.5 0 0".encode())
        reference(1.0 + 0.01 * k)
    assert reference(2.0).pose_in_wall[0] > 0.3


def test_one_cycle_takes_a_bounded_number_of_datagrams_and_lines(port):
    lines, send = port
    crammed = f"{TOKEN} ".encode() + b"v 0 0 0\n" * 500
    for _ in range(20):
        send(crammed)
    send(f"{TOKEN} v 0.1 0 0".encode())
    found = lines.pending()
    assert len(found) == 64
    assert found[-1] == "v 0.1 0 0"
    assert lines.counts()["dropped"] == 20 * 500 + 1 - 64
    for _ in range(1000):
        send(b"junk")
    lines.pending()
    assert lines.strangers <= 256


def test_a_token_is_made_and_reported_or_taken_from_the_environment(monkeypatch):
    monkeypatch.delenv(TOKEN_VARIABLE, raising=False)
    reported = set()
    for _ in range(2):
        lines = open_commands("udp:0")
        reported.add(lines.where.split("token ")[1])
        lines.close()
    assert len(reported) == 2
    assert {len(token) for token in reported} == {32}
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    lines = open_commands("udp:0")
    assert "token" not in lines.where
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(f"{TOKEN} stop".encode(), ("127.0.0.1", lines.port))
    assert lines.pending() == ["stop"]
    lines.close()


@pytest.mark.parametrize("token", ["", "with a space in it", "grüße-0123456789"])
def test_a_token_that_is_none_is_refused(monkeypatch, token):
    monkeypatch.setenv(TOKEN_VARIABLE, token)
    with pytest.raises(UsageError, match=TOKEN_VARIABLE):
        open_commands("udp:0")


@pytest.mark.parametrize("port", ["²", "", "99999"])
def test_a_port_that_is_none_is_refused(port):
    with pytest.raises(UsageError, match=r"--command udp:|UDP port 99999"):
        open_commands(f"udp:{port}")
