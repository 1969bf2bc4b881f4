"""The daemon at its bus: a failed bus is retried for ever and reported; so are other programs' commands."""

import threading
import time

import can
import pytest
from can_bus import Bus

from hil.core.clock import nanoseconds
from hil.core.errors import DeviceError
from hil.fan_daemon import bus_cycle
from hil.fan_daemon.bus_cycle import BusCycle
from hil.fan_daemon.fan_control import FanControl, SetPoint
from hil.fan_daemon.spec import Spec

SPEC = Spec("udp_multicast", "239.74.164.9", 7)
PERIOD_NS = nanoseconds(SPEC.period_s)


@pytest.fixture
def said():
    return []


@pytest.fixture
def kept(said):
    """A daemon at a bus, with its fan at duty 0.57."""
    daemon, bus = FanControl(SPEC), Bus()
    daemon.resume(0, SetPoint("duty", 0.57123), SetPoint("duty", 0.57123))
    return BusCycle(SPEC, daemon, said.append, bus), bus


def run(cycle, start_s, duration_s):
    for t_ns in range(nanoseconds(start_s), nanoseconds(start_s + duration_s), PERIOD_NS):
        cycle.step(t_ns)


def test_a_command_every_period_byte_for_byte(kept):
    cycle, bus = kept
    run(cycle, 0.0, 1.0)
    assert bus.sent == [(0x0007, bytes.fromhex("0000DF23"), True)] * 20
    assert cycle.worst_gap_ns == PERIOD_NS


class ClosedError(Exception):
    """As python-can-remote raises: of no class that python-can knows."""


@pytest.mark.parametrize(
    "error",
    [can.CanOperationError("Transmit buffer full"), OSError(19, "No such device"), ClosedError("1006")],
)
def test_a_bus_that_fails_is_opened_again_for_ever_and_reported_once(kept, said, monkeypatch, error):
    cycle, bus = kept
    attempts = []

    def opened(spec):
        attempts.append(spec)
        if len(attempts) < 50:
            raise DeviceError("adhesion", "the CAN bus cannot be opened (No such device)")
        return again

    again = Bus()
    monkeypatch.setattr(bus_cycle, "open_bus", opened)
    run(cycle, 0.0, 0.5)
    bus.error = error
    run(cycle, 0.5, 40.0)
    assert "commands do not reach the fan" in said[-2]
    assert len(said) <= 5
    assert said[-1] == "CAN: works again"
    assert again.sent
    assert cycle.status(nanoseconds(40.5))["worst_gap_s"] > 10.0
    assert cycle.bus_error == ""


@pytest.mark.parametrize("error", [ClosedError("1006"), IndexError("string index out of range")])
def test_a_bus_that_hears_nothing_and_swallows_what_is_sent_is_opened_again(kept, said, monkeypatch, error):
    """python-can-remote: once its connection is closed, receiving raises and sending does nothing at all."""
    cycle, bus = kept
    again = Bus()
    monkeypatch.setattr(bus_cycle, "open_bus", lambda spec: again)
    run(cycle, 0.0, 0.5)
    bus.deaf = error
    run(cycle, 0.5, 1.0)
    assert again.sent
    assert "commands do not reach the fan" in said[-2]
    assert said[-1] == "CAN: works again"
    assert cycle.status(nanoseconds(1.5))["worst_gap_s"] > 0.5


def test_damaged_frames_on_a_bus_that_works_are_passed_over(kept, said):
    cycle, bus = kept
    for _ in range(40):
        bus.arriving = [IndexError("string index out of range")] * 3
        run(cycle, 0.05 * _, 0.05)
    assert cycle.worst_gap_ns == PERIOD_NS
    assert len(bus.sent) == 40
    assert not any("CAN" in text for text in said)


def test_a_bus_that_takes_long_to_open_does_not_hold_up_the_daemon(said, monkeypatch):
    """Connecting to a host that is switched off takes minutes; requests are answered meanwhile."""
    opened, again = threading.Event(), Bus()

    def slowly(spec):
        opened.wait(10.0)
        return again

    monkeypatch.setattr(bus_cycle, "open_bus", slowly)
    cycle = BusCycle(SPEC, FanControl(SPEC), said.append)
    cycle.control.resume(0, SetPoint("duty", 0.5), SetPoint("duty", 0.5))
    began_s = time.monotonic()
    run(cycle, 0.0, 0.5)
    assert time.monotonic() - began_s < 5.0
    opened.set()
    run(cycle, 0.5, 0.5)
    cycle.close()
    assert again.sent


def test_another_program_that_commands_the_fan_is_reported_and_not_followed(kept, said):
    cycle, bus = kept
    for t_s in range(5):
        bus.arriving = [can.Message(arbitration_id=0x0007, data=bytes.fromhex("00001388"))]
        run(cycle, float(t_s), 1.0)
    assert [text for text in said if "another program" in text] == [
        "another program commands this fan: duty 0.05"
    ]
    assert {data.hex().upper() for _, data, _ in bus.sent} == {"0000DF23"}


def test_its_own_echo_is_no_other_program(kept, said):
    cycle, bus = kept
    run(cycle, 0.0, 0.1)
    bus.arriving = [can.Message(arbitration_id=i, data=d) for i, d, _ in bus.sent]
    run(cycle, 0.1, 0.1)
    assert not any("another program" in text for text in said)


def test_what_a_hostile_bus_carries_does_not_stop_it(kept):
    cycle, bus = kept
    bus.arriving = [
        can.Message(arbitration_id=0x0907, data=b"\x00"),
        can.Message(arbitration_id=0x0907, is_remote_frame=True, dlc=8),
        can.Message(is_error_frame=True, dlc=8, data=bytes(8)),
        can.Message(arbitration_id=0x107, is_extended_id=False, data=b"\xff" * 8),
        *[can.Message(arbitration_id=i << 8 | 7, data=b"\xff" * 8) for i in range(60)],
    ] * 20
    run(cycle, 0.0, 1.0)
    assert {data.hex().upper() for _, data, _ in bus.sent} == {"0000DF23"}
    assert len(bus.sent) == 20
