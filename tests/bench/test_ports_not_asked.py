"""What discovery writes where: nothing to ports that may hold a robot, and no setting of any device."""

import errno
import io
import os
import pty
import select
import subprocess
import sys
import tty
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from hil.bench.doctor.discovery import what_is_written
from hil.bench.doctor.protected_ports import ports_that_hold, why_not_asked
from hil.bench.emulated_devices import build_world
from hil.cli import main
from hil.config.loading import load_bench
from hil.config.thrust import TeensyConfig
from hil.core.registry import kinds
from hil.fakes.imu.bno055.chip import Bno055Chip
from hil.fakes.imu.microstrain.chip import MicrostrainChip
from hil.fakes.serial_line import SerialLine
from hil.fakes.thrust.teensy.chip import TeensyChip
from hil.fakes.thrust.teensy.true_parameters import ThrustTruthOptions
from hil.fakes.world import VirtualClock, World
from hil.links.serial_url import cannot_open, open_serial
from tests.turning_plant import TurningPlant

SETTINGS = {"baud": 115_200, "timeout_s": 0.0, "write_timeout_s": 0.1}


@pytest.fixture
def port():
    """(A serial port that nothing answers at, what was written to it so far)."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    os.close(slave)

    def written():
        data = b""
        while select.select([master], [], [], 0)[0]:
            try:
                data += os.read(master, 4096)
            except OSError:  # all clients have closed it
                break
        return data

    yield path, written
    os.close(master)


def bench_file(folder, name, port, kind="thrust"):
    path = folder / name
    path.write_text(f'schema = 1\nname = "mine"\n[{kind}]\nport = "{port}"\n')
    return path


@contextmanager
def held_open_elsewhere(path):
    """Another program that has a port open, and knows of no locks."""
    with open(path, "rb", buffering=0) as held, subprocess.Popen(["sleep", "60"], stdin=held) as other:
        try:
            held.close()
            yield other
        finally:
            other.kill()


def test_a_port_that_another_program_has_open_is_left_alone(port):
    path, _ = port
    assert why_not_asked(path, {}) == ""
    with held_open_elsewhere(path) as other:
        assert why_not_asked(path, {}) == f"sleep (process {other.pid}) has it open"
        busy = cannot_open("servos", path, OSError(16, "busy"), expected="a servo")
        assert f"sleep (process {other.pid})" in busy.remedy


@pytest.mark.parametrize(
    ("number", "says"),
    [
        (errno.EACCES, "udev rule"),
        (errno.EBUSY, "sudo fuser -v {path} names it"),
        (errno.ENOENT, "check cable and hub"),
    ],
)
def test_a_port_that_cannot_be_opened_has_the_doctors_remedy(port, monkeypatch, number, says):
    """Its own group and mode, its own name: as `hil doctor` says of a device at this port."""
    path, _ = port
    os.chmod(path, 0o600)
    error = OSError(number, os.strerror(number))

    def refused(*_, **__):
        raise error

    monkeypatch.setattr("hil.bench.doctor.protected_ports.open_serial", refused)
    why = why_not_asked(path, {})
    assert why.endswith(cannot_open("servos", path, error, expected="").remedy)
    assert says.format(path=path) in why
    assert os.strerror(number) in why


def test_ports_of_propellers_are_known_by_bench_files(tmp_path, port):
    path, _ = port
    link = tmp_path / "link"
    link.symlink_to(path)
    (tmp_path / "here").mkdir()
    bench_file(tmp_path / "here", "lab.toml", path)
    (tmp_path / "here" / "broken.toml").write_text("[")
    known = ports_that_hold((), tmp_path / "here")
    assert "propellers" in why_not_asked(path, known)
    assert "propellers" in why_not_asked(str(link), known)
    assert why_not_asked("socket://127.0.0.1:1", known) == ""
    named = bench_file(tmp_path, "far.toml", "socket://127.0.0.1:1")
    assert "far.toml" in why_not_asked("socket://127.0.0.1:1", ports_that_hold((named,), tmp_path / "none"))
    imu = bench_file(tmp_path, "imu.toml", path, kind="imu")
    assert ports_that_hold((imu,), tmp_path / "none") == {}


def test_a_teensy_is_known_by_its_usb_ids(port, monkeypatch):
    path, _ = port
    listed = [SimpleNamespace(device=path, vid=0x16C0, pid=0x0483)]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: listed)
    assert why_not_asked(path, {})
    listed[0].vid, listed[0].pid = 0x0403, 0x6014
    assert not why_not_asked(path, {})


def test_drivers_of_one_program_share_a_port_and_keep_other_programs_out(port):
    path, _ = port
    taken = f"import serial; serial.Serial({path!r}, 9600, exclusive=True)"

    def another_program():
        return subprocess.run([sys.executable, "-c", taken], capture_output=True, check=False).returncode

    one, two = (open_serial(path, **SETTINGS, shared=True) for _ in range(2))
    assert another_program() == 1
    one.close()
    assert another_program() == 1
    two.close()
    two.close()
    assert another_program() == 0
    exclusive = open_serial(path, **SETTINGS)
    with pytest.raises(OSError, match=r"temporarily unavailable"):
        open_serial(path, **SETTINGS, shared=True)
    exclusive.close()


@pytest.mark.parametrize("alone", ["by its bench file", "since no option says that the robot stands"])
def test_nothing_is_written_to_a_port_that_is_left_alone(tmp_path, monkeypatch, capsys, port, alone):
    path, written = port
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO())
    if alone == "by its bench file":
        bench_file(tmp_path, "bench.toml", path)
        assert main(["discover", "--on-stand", "--port", path]) == 3
    else:
        assert main(["discover", "--port", path]) == 4
        said = capsys.readouterr().err
        assert all(text in said for text in (path, *what_is_written(), "--on-stand"))
    assert written() == b""


def test_what_is_asked_of_a_port_is_an_error_to_the_propellers_controller():
    """Why their port is left alone: they slow down, as the firmware of such a controller does."""
    config = load_bench("emulated", overrides={"emulation.thrust.start": "running"})
    world = build_world(config, seed=1)
    chip = TeensyChip(world, TeensyConfig(), ThrustTruthOptions(start="running"))
    before = chip.step
    assert before > 0
    for baud, data in [(115_200, b"\xaa\x01\x00\x07"), (57_600, b"THR90\n"), (115_200, b"\n")]:
        chip.receive(data, world.now_ns, baud)
    for tick in range(1, 41):
        chip.poll(tick * 100_000_000)
    assert chip.step <= before - 30


def what_a_bno055_says(clock):
    """Its modes, units and axes, registers 0x3B to 0x42."""
    with open_serial("hil://imu", **SETTINGS) as port:
        port.write(bytes((0xAA, 0x01, 0x3B, 8)))
        clock.sleep_until_ns(clock.now_ns() + 20_000_000)
        return port.read(100)


def what_a_microstrain_says(clock):
    """How much it sends in half a second, unasked."""
    with open_serial("hil://imu", **SETTINGS) as port:
        port.read(100_000)
        clock.sleep_until_ns(clock.now_ns() + 500_000_000)
        return round(len(port.read(100_000)) / 500)


@pytest.mark.parametrize(
    ("name", "chip", "says"),
    [("bno055", Bno055Chip, what_a_bno055_says), ("microstrain", MicrostrainChip, what_a_microstrain_says)],
)
def test_an_inertial_unit_that_is_asked_keeps_its_settings(name, chip, says):
    world = World(TurningPlant(), seed=1)
    line = SerialLine(world, chip(world)).open()
    clock, model = VirtualClock(world), kinds()["imu"].model(name)
    driver = model.make_driver(model.config(port="hil://imu", backend="emulated"), clock)
    driver.open()
    driver.close()
    before = says(clock)
    assert before
    assert model.probe("hil://imu", clock).table["port"] == "hil://imu"
    assert says(clock) == before
    other = next(m for m in kinds()["imu"].models if m.can_probe and m.name != name)
    assert other.probe("hil://imu", clock) is None
    assert says(clock) == before
    line.close()
