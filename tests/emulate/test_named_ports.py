"""Serial ports and CAN buses that a bench file names are where `hil emulate` serves its devices."""

import os
import re
from pathlib import Path

import can
import pytest
import serial
from emulators import emulator

from hil.bench import open_emulation
from hil.cli.emulate import PortLinks
from hil.config.loading import load_bench
from hil.fakes.free_port import free_udp_port

pytestmark = pytest.mark.usefixtures("warm_commands")

TWO = 'schema = 1\nname = "two"\n[servos]\nbackend = "emulated"\nport = "{}"\n[imu]\nbackend = "emulated"\n'


@pytest.fixture
def bench_file(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text(TWO.format(tmp_path / "servos"))
    return path


@pytest.fixture
def links(bench_file):
    config = load_bench(str(bench_file))
    server = open_emulation(config, seed=1)
    made = PortLinks(config, server.endpoints())
    yield made
    made.remove()
    for transport in server.transports.values():
        transport.close()


def test_a_named_port_is_a_link_while_it_is_served(links, tmp_path):
    assert links.make() == []
    link = tmp_path / "servos"
    assert re.fullmatch(r"/dev/pts/\d+", os.readlink(link))
    serial.Serial(str(link)).close()
    links.remove()
    assert [p.name for p in tmp_path.iterdir()] == ["bench.toml"], (
        "an IMU whose port is not named has no link"
    )


def test_what_is_there_already_is_left_alone(links, tmp_path):
    (tmp_path / "servos").write_text("mine")
    (reported,) = links.make()
    assert re.fullmatch(
        rf"servos: {tmp_path}/servos is there already and is left alone; served at /dev/pts/\d+", reported
    )
    links.remove()
    assert (tmp_path / "servos").read_text() == "mine"


def test_a_link_that_a_killed_emulator_left_is_made_anew(links, tmp_path):
    (tmp_path / "servos").symlink_to("/dev/pts/999999")
    assert links.make() == []
    assert os.path.exists(tmp_path / "servos")


def test_a_link_of_the_users_own_to_an_adapter_that_is_unplugged_is_left_alone(links, tmp_path):
    adapter = "/dev/serial/by-id/usb-of-another-day"
    (tmp_path / "servos").symlink_to(adapter)
    (reported,) = links.make()
    assert "is there already and is left alone" in reported
    links.remove()
    assert os.readlink(tmp_path / "servos") == adapter


def test_a_folder_that_is_not_there_is_named(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text(TWO.format(tmp_path / "none" / "servos"))
    links = PortLinks(load_bench(str(path)), {"servos": {"port": "/dev/pts/1"}})
    assert links.make() == [
        f"servos: {tmp_path}/none/servos cannot be made (No such file or directory); served at /dev/pts/1"
    ]


@pytest.mark.parametrize(
    ("port", "of_hardware", "linked"),
    [
        ("/dev/no-such-folder/ttyUSB0", False, False),
        ("/dev/no-such-folder/ttyUSB0", True, True),
        ("socket://127.0.0.1:4000", True, False),
    ],
)
def test_ports_of_hardware_are_made_where_that_was_asked_for(tmp_path, port, of_hardware, linked):
    path = tmp_path / "bench.toml"
    path.write_text(TWO.format(port))
    config = load_bench(str(path))
    links = PortLinks(config, {"servos": {"port": "/dev/pts/1"}}, of_hardware=of_hardware)
    assert [port in reported for reported in links.make()] == ([True] if linked else [])


def test_the_command_makes_them_and_takes_them_with_it(bench_file):
    link = bench_file.parent / "servos"
    with emulator("--bench", str(bench_file)) as process:
        served = process.endpoints()["servos"]["port"]
        assert os.readlink(link) == served
    assert not Path(link).is_symlink()


def test_a_multicast_bus_is_served_at_its_own_group_and_port(tmp_path):
    group, port, path = f"239.74.200.{1 + os.getpid() % 250}", free_udp_port(), tmp_path / "bench.toml"
    path.write_text(
        'schema = 1\nname = "bus"\n[encoders]\nbackend = "emulated"\ninterface = "udp_multicast"\n'
        f'channel = "{group}"\noptions = {{ port = {port}, hop_limit = 0 }}\n'
    )
    with emulator("--bench", str(path)) as process:
        reported = process.endpoints()["can"]
        assert (reported["channel"], reported["port"]) == (group, port)
        with can.Bus(interface="udp_multicast", channel=group, port=port, hop_limit=0) as bus:
            assert bus.recv(5.0) is not None
