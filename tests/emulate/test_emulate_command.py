"""What `hil emulate` promises as a command: its line, its end, its refusals, its neighbours."""

import signal
from contextlib import ExitStack, suppress
from pathlib import Path

import can
import pytest
import serial
from emulators import END_S, emulator

from hil.cli import main
from hil.fakes.emulated_can_group import DEFAULT_PORT

pytestmark = pytest.mark.usefixtures("warm_commands")
ENDS = ("SIGINT", "SIGTERM", "SIGHUP", "lifeline")


def chip_id(endpoint):
    """First register of the BNO055, asked as any client would."""
    with suppress(serial.SerialException), serial.Serial(endpoint["port"], 115200, timeout=0.2) as port:
        for _ in range(20):
            port.write(b"\xaa\x01\x00\x01")
            reported = port.read(3)
            if reported[:2] == b"\xbb\x01":
                return reported[2]
            port.reset_input_buffer()
    raise AssertionError(f"no answer at {endpoint['port']}")


def test_the_line_says_how_to_reach_every_device(served):
    found = served
    assert set(found) >= {"servos", "imu", "can", "mocap"}
    assert found["servos"]["ids"] == list(range(1, 9))
    for name in ("servos", "imu"):
        assert Path(found[name]["port"]).exists()
        assert found[name]["baud"] > 0
    assert found["imu"]["baud"] == 115200
    assert found["can"]["interface"] == "udp_multicast"
    assert Path(found["can"]["dbc"]).is_file()
    assert set(found["mocap"]) >= {"server", "command_port", "data_port", "multicast"}
    assert found["mocap"]["server"] == "127.0.0.1"


def test_group_and_channel_are_enough_for_a_can_client(served):
    """The first emulator of a host is at python-can's default port."""
    if served["can"]["port"] != DEFAULT_PORT:
        pytest.skip("another program on this host uses python-can's default multicast port")
    where = {k: served["can"][k] for k in ("interface", "channel")}
    assert frames_heard(where) > 20


@pytest.fixture(scope="module")
def several():
    """Several at once: they need seconds to start."""
    with ExitStack() as stack:
        running = [stack.enter_context(emulator("--only", "imu", "--lifeline")) for _ in ENDS]
        yield {r.process: r.endpoints()["imu"] for r in running}


@pytest.mark.parametrize("how", ENDS)
def test_it_ends_in_order_and_takes_its_ports_with_it(several, how):
    process = next(p for p in several if p.poll() is None)
    endpoint = several[process]
    assert chip_id(endpoint) == 0xA0
    if how == "lifeline":
        process.stdin.close()
    else:
        process.send_signal(getattr(signal, how))
    assert process.wait(END_S) == 0
    assert process.stdout.read() == ""
    assert [line.split()[:3] for line in process.stderr] == [["at", "the", "start"], ["at", "the", "end"]]
    with pytest.raises(AssertionError, match="no answer"):
        chip_id(endpoint)


@pytest.mark.usefixtures("started_commands")
def test_under_nohup_a_closed_terminal_does_not_end_it():
    former = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with emulator("--only", "imu", "--lifeline") as running:
            endpoint = running.endpoints()["imu"]
            running.process.send_signal(signal.SIGHUP)
            assert chip_id(endpoint) == 0xA0
            assert running.process.poll() is None
            running.process.send_signal(signal.SIGTERM)
            assert running.process.wait(END_S) == 0
    finally:
        signal.signal(signal.SIGHUP, former)


def test_a_second_one_works_beside_the_first(served, emulate):
    second = emulate("--only", "can,imu,mocap")
    first = served
    assert set(second) == {"can", "imu", "mocap"}
    assert chip_id(second["imu"]) == chip_id(first["imu"]) == 0xA0
    assert second["imu"]["port"] != first["imu"]["port"]
    assert second["mocap"]["command_port"] != first["mocap"]["command_port"]
    assert second["can"]["port"] != first["can"]["port"]
    assert frames_heard(second["can"]) > 20


def frames_heard(where):
    with can.Bus(**{k: v for k, v in where.items() if k != "dbc"}) as bus:
        return sum(bus.recv(1.0) is not None for _ in range(40))


@pytest.mark.parametrize(
    ("options", "reported"),
    [
        (("--only", "imx"), "--only imx: the bench has no such device"),
        (("--only", "imu", "--fault", "servos:drop"), "no emulated device of that name"),
        (("--bench", "nowhere.toml"), "nowhere.toml: cannot be read"),
    ],
)
def test_what_cannot_be_served_is_refused(options, reported, capsys):
    assert main(["emulate", *options]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert reported in said.err
