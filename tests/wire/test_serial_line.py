"""The emulated serial line as a client meets it: pacing, latency, timeouts, faults, in both transports."""

import os
import threading

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from hil.core.clock import MonotonicClock
from hil.core.errors import FaultNotSupportedError, UsageError
from hil.fakes.serial_chip import Reply, SerialChip
from hil.fakes.serial_line import SerialLine, decode_at_baud, find_line
from hil.fakes.serial_pty import SerialPty
from hil.fakes.server import EmulationServer
from hil.fakes.world import World
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan
from tests.still_plant import StillPlant


class Echo(SerialChip):
    """Answers every request with its upper-case form, and notes what it heard."""

    def __init__(self, name="echo", baud=115_200):
        self.name, self.supported_faults = name, {"off": ()}
        self.baud, self.heard = baud, []

    def receive(self, data, t_ns, baud):
        self.heard.append((t_ns, data, baud))
        return [Reply(t_ns + 1_000_000, data.upper())] if baud == self.baud else []

    def reset(self, t_ns):
        self.heard.clear()


class Beacon(Echo):
    """Says something unasked every 10 ms."""

    due_ns = 10_000_000

    def next_poll_ns(self):
        return self.due_ns

    def poll(self, t_ns):
        self.due_ns = t_ns + 10_000_000
        return [Reply(t_ns, b"!")]


@pytest.fixture
def wired():
    lines = []

    def build(*faults, chip=None, latency_s=0.001, timeout=0.1, baud=115_200):
        world = World(StillPlant(), seed=3, faults=FaultPlan([parse_fault(f) for f in faults]))
        chip = Echo() if chip is None else chip
        line = SerialLine(world, chip, latency_s=latency_s).open()
        lines.append(line)
        world.faults.check()
        return world, chip, serial.serial_for_url("hil://echo", baudrate=baud, timeout=timeout)

    yield build
    for line in lines:
        line.close()


def test_a_request_and_its_answer_take_the_time_of_the_wire(wired):
    world, chip, port = wired()
    port.write(b"abcde")
    assert world.now_ns == 0
    assert port.read(5) == b"ABCDE"
    byte_ns = 10e9 / 115_200
    assert chip.heard[0][0] == pytest.approx(5 * byte_ns, abs=5)
    assert world.now_ns == pytest.approx(10 * byte_ns + 1e6 + 1e6, abs=10)


def test_a_full_usb_packet_does_not_wait_for_the_latency_timer(wired):
    world, _, port = wired(latency_s=0.016)
    port.write(b"a" * 62)
    assert len(port.read(62)) == 62
    assert world.now_ns < 14_000_000
    port.write(b"b")
    began_ns = world.now_ns
    assert port.read(1) == b"B"
    assert world.now_ns - began_ns > 16_000_000


def test_without_latency_every_byte_is_handed_over_as_it_arrives(wired):
    world, _, port = wired(latency_s=0.0)
    port.write(b"abc")
    assert port.read(1) == b"A"
    assert world.now_ns == pytest.approx(4 * 10e9 / 115_200 + 1e6, abs=10)


def test_silence_costs_the_timeout_and_an_empty_look_a_little(wired):
    world, _, port = wired(baud=9600)
    port.write(b"x")
    assert port.read(1) == b""
    assert world.now_ns == 100_000_000
    assert port.in_waiting == 0
    assert world.now_ns == 100_050_000
    port.timeout = 0
    assert port.read(1) == b""
    assert world.now_ns == 100_100_000


def test_waiting_for_ever_on_a_silent_line_is_an_error_not_a_hang(wired):
    _, _, port = wired(timeout=None)
    with pytest.raises(serial.SerialException, match="nothing will ever arrive"):
        port.read(1)


def test_reset_input_buffer_forgets_only_what_has_arrived(wired):
    _, _, port = wired()
    port.write(b"old")
    port.read(1)
    port.reset_input_buffer()
    port.write(b"new")
    assert port.read(3) == b"NEW"


def test_who_opens_a_port_does_not_hear_what_came_before(wired):
    world, _, port = wired()
    port.write(b"old")
    world.advance_to(world.now_ns + 100_000_000)
    port.close()
    with serial.serial_for_url("hil://echo", baudrate=115_200, timeout=0.1) as again:
        assert again.read(3) == b""
        again.cancel_read()
        again.cancel_write()
        again.write(b"new")
        assert again.read(3) == b"NEW"


def test_a_port_has_one_client_and_a_line_one_name(wired):
    world, _, port = wired()
    with pytest.raises(serial.SerialException, match="in use"):
        serial.serial_for_url("hil://echo")
    port.close()
    serial.serial_for_url("hil://echo").close()
    with pytest.raises(UsageError, match="exists already"):
        SerialLine(world, Echo()).open()
    with pytest.raises(serial.SerialException, match=r"open ones: .*echo"):
        serial.serial_for_url("hil://other")


def test_a_chip_may_speak_unasked(wired):
    world, _, port = wired(chip=Beacon(), latency_s=0.0, timeout=0.05)
    port.write(b"x")
    assert port.read(4) == b"X!!!"
    assert world.now_ns == pytest.approx(30_000_000, abs=200_000)


def test_a_port_has_the_face_of_any_other(wired):
    """What terminal programs touch: modem lines, buffers, break."""
    _, _, port = wired()
    assert (port.cts, port.dsr, port.ri, port.cd) == (True, True, False, True)
    port.rts = port.dtr = True
    port.break_condition = True
    port.reset_output_buffer()
    assert port.write(b"") == 0
    port.close()
    with pytest.raises(serial.SerialException, match="not open"):
        port.write(b"x")


def test_flush_waits_until_the_bytes_have_left(wired):
    world, chip, port = wired()
    port.write(b"abcd")
    port.flush()
    assert chip.heard
    assert world.now_ns == pytest.approx(4 * 10e9 / 115_200, abs=5)


@pytest.mark.parametrize(
    ("fault", "heard", "seen"),
    [
        ("drop@1+1,probability=1", 1, b""),
        ("drop@1+1,probability=1,direction=out", 0, b""),
        ("silent@1+1", 1, b""),
        ("silent@1+1,direction=out", 0, b""),
        ("silent@1+1,direction=both", 0, b""),
        ("duplicate@1+1,probability=1", 1, b"ABAB"),
        ("duplicate@1+1,probability=1,direction=both", 2, b"ABAB" * 2),
        ("unplug@1+1", 0, None),
        ("baud_mismatch@1+1", 1, b""),
    ],
)
def test_wire_faults_act_while_they_are_active_on_their_way(wired, fault, heard, seen):
    world, chip, port = wired(f"echo:{fault}")
    port.write(b"ab")
    assert port.read(2) == b"AB"
    world.advance_to(1_500_000_000)
    if seen is None:
        with pytest.raises(serial.SerialException, match="gone"):
            port.write(b"ab")
    else:
        port.write(b"ab")
        assert port.read(20) == seen
    assert len(chip.heard) == 1 + heard
    if "baud_mismatch" in fault:
        assert chip.heard[-1][2] == 57_600
    world.advance_to(3_000_000_000)
    port.write(b"cd")
    assert port.read(2) == b"CD"


@pytest.mark.parametrize("kind", ["corrupt", "truncate"])
def test_damaged_transfers_differ_from_what_was_sent(wired, kind):
    _, chip, port = wired(f"echo:{kind},probability=1,direction=both")
    for _ in range(5):
        port.write(b"abcdefgh")
        assert port.read(8) != b"ABCDEFGH"
    assert chip.heard
    assert all(data != b"abcdefgh" for _, data, _ in chip.heard)


def test_a_fault_that_neither_chip_nor_line_knows_is_refused(wired):
    with pytest.raises(FaultNotSupportedError, match="bus_off"):
        wired("echo:bus_off")


def asked_until(port, done):
    """Ask up to ten times, as an emulator without processor time loses answers; whether it is done."""
    for _ in range(10):
        port.write(b"hello")
        if done(port.read(5)):
            return True
    return False


@pytest.mark.real_time
@pytest.mark.parametrize("baud", [9600, 1_000_000, 4_500_000])
def test_a_terminal_client_is_heard_at_the_rate_it_has_set(baud):
    chip = Echo(baud=baud)
    world = World(StillPlant())
    transport = SerialPty(SerialLine(world, chip), {"baud": baud})
    server = EmulationServer(world, MonotonicClock(), {"echo": transport})
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        with serial.Serial(transport.endpoint()["port"], baud, timeout=2.0) as port:
            assert asked_until(port, lambda answer: answer == b"HELLO")
            assert chip.heard[-1][2] == baud
            port.baudrate = 19_200
            port.timeout = 0.1
            port.reset_input_buffer()
            assert asked_until(port, lambda _: chip.heard[-1][2] == 19_200)
            assert port.read(5) == b""
    finally:
        server.stop()
        thread.join(5)
    assert not transport.filenos()
    assert not os.path.exists(transport.endpoint()["port"] or "gone")


def test_a_terminal_that_is_not_read_loses_and_counts():
    chip = Echo()
    world = World(StillPlant())
    line = SerialLine(world, chip, latency_s=0.001)
    transport = SerialPty(line)
    client = serial.Serial(transport.endpoint()["port"])
    try:
        while transport.lost < 500 and world.now_ns < 60_000_000_000:
            line.send(b"a" * 62, 115_200)
            world.advance_to(world.now_ns + 20_000_000)
            while transport.next_due_ns() <= world.now_ns:
                transport.on_due(world.now_ns)
        assert transport.lost >= 500
    finally:
        client.close()
        transport.close()
    line.send(b"late", 115_200)
    world.advance_to(world.now_ns + 100_000_000)
    transport.on_due(world.now_ns)
    transport.close()
    assert transport.endpoint()["port"] == ""


def test_what_a_chip_says_far_too_late_is_lost_and_counted():
    """A client would take it for the answer to what it has asked since."""
    world = World(StillPlant())
    line = SerialLine(world, Echo())
    transport = SerialPty(line)
    try:
        with serial.Serial(transport.endpoint()["port"], 115_200, timeout=0.0) as port:
            for transport.behind, heard in ((True, b""), (False, b"LATE")):
                line.send(b"late", 115_200)
                world.advance_to(world.now_ns + 20_000_000)
                transport.on_due(world.now_ns)
                assert port.read(10) == heard
        assert transport.lost == 4
    finally:
        transport.close()


class Deaf(Beacon):
    """Has a UART of its own rate, and never asks at which rate it is spoken to."""

    def __init__(self, rate):
        super().__init__()
        self.uart_baud = rate

    def receive(self, data, t_ns, baud):
        self.heard.append((t_ns, data, baud))
        return [Reply(t_ns, data.upper())] if data else []

    def poll(self, t_ns):
        self.due_ns = t_ns + 10_000_000
        return [Reply(t_ns, b"unasked ")]


def spoken(wired, *faults, rate=115_200, **how):
    """What such a chip has heard of a request, and what the client then hears within 50 ms."""
    world, chip, port = wired(*faults, chip=Deaf(rate), **how)
    port.write(b"a request")
    world.advance_to(world.now_ns + 50_000_000)
    return b"".join(data for _, data, _ in chip.heard), port.read(port.in_waiting)


@pytest.mark.parametrize(
    ("faults", "rates"),
    [
        (("echo:baud_mismatch",), {}),
        (("echo:baud_mismatch",), {"rate": None}),
        ((), {"baud": 230_400}),
        ((), {"rate": 1_000_000}),
    ],
)
def test_another_rate_is_noise_to_both_whatever_the_chip_thinks(wired, faults, rates):
    heard, answered = spoken(wired, *faults, **rates)
    assert b"a request" not in heard
    assert heard
    assert b"A REQUEST" not in answered
    assert b"unasked" not in answered
    assert answered
    find_line("echo").close()
    assert (heard, answered) == spoken(wired, *faults, **rates), "the noise is no matter of chance"


@pytest.mark.parametrize("rates", [{}, {"baud": 117_000}, {"rate": None, "baud": 9_600}])
def test_nearly_the_same_rate_is_understood(wired, rates):
    heard, answered = spoken(wired, **rates)
    assert heard == b"a request"
    assert b"A REQUEST" in answered
    assert b"unasked" in answered


@given(data=st.binary(max_size=40), off=st.floats(-0.03, 0.03))
def test_a_uart_reads_what_was_sent_at_its_rate(data, off):
    assert decode_at_baud(data, 115_200 * (1 + off), 115_200) == data


def test_a_uart_at_half_the_rate_reads_by_its_own_bits():
    """Nine low bits are four and a half of its own: one starts, three are 0, and what follows is the rest."""
    assert decode_at_baud(b"\x00", 9_600, 4_800) == bytes([0b11111000])
