"""A USB adapter as delivered keeps replies for 16 ms: `hil doctor` names it, whatever the port is called."""

import json
import subprocess
import sys
from contextlib import contextmanager

import pytest

import hil
from hil.bench.doctor.examination import examine
from hil.bench.doctor.port_findings import Host
from hil.bench.emulated_devices import build_world, connect_in_process
from hil.config.loading import load_bench
from hil.core.clock import MonotonicClock
from hil.core.signals import KINDS
from hil.drivers.servos.dynamixel.commissioning import scan, set_up
from hil.fakes.world import VirtualClock
from hil.links.serial_url import latency_timer

pytestmark = pytest.mark.usefixtures("warm_commands")

END_S = 20.0
SERVOS_ONLY = dict.fromkeys(("encoders", "imu", "tracker", "mocap"))


@pytest.fixture
def system(tmp_path):
    """A fake `/dev` and `/sys` with one FTDI adapter as delivered, and the link that udev makes."""
    timer = tmp_path / "sys/bus/usb-serial/devices/ttyUSB0/latency_timer"
    by_id = tmp_path / "dev/serial/by-id"
    timer.parent.mkdir(parents=True)
    by_id.mkdir(parents=True)
    timer.write_text("16\n")
    (tmp_path / "dev/ttyUSB0").touch()
    (by_id / "usb-FTDI_U2D2_FT4T-if00-port0").symlink_to("../../ttyUSB0")
    return tmp_path


@pytest.mark.parametrize("port", ["socket://host:2000/ttyUSB0", "/dev/ttyACM0"])
def test_other_ports_have_no_timer(system, port):
    assert latency_timer(port, system / "sys") is None


def test_doctor_reports_the_timer_of_a_linked_port_and_of_nothing_else_first(system):
    port = system / "dev/serial/by-id/usb-FTDI_U2D2_FT4T-if00-port0"
    values = {"servos.backend": "real", "servos.port": str(port)}
    bench = hil.open_bench("emulated", overrides=dict.fromkeys(set(KINDS) - {"servos"}) | values)
    first, opened = examine(bench, watch_s=0.1, host=Host(sysfs=system / "sys"))
    assert (first.check, first.level, first.found) == ("latency timer", "warning", "16 ms")
    assert (opened.check, opened.level) == ("open", "failure")
    for finding in (first, opened):
        assert f"| sudo tee {system}/sys/bus/usb-serial/devices/ttyUSB0/latency_timer" in finding.remedy


@pytest.mark.parametrize("text", ["1\n", "nonsense"])
def test_a_timer_that_is_set_or_unreadable_is_no_warning(system, text):
    (system / "sys/bus/usb-serial/devices/ttyUSB0/latency_timer").write_text(text)
    values = {"servos.backend": "real", "servos.port": str(system / "dev/ttyUSB0")}
    bench = hil.open_bench("emulated", overrides=dict.fromkeys(set(KINDS) - {"servos"}) | values)
    found = list(examine(bench, watch_s=0.1, host=Host(sysfs=system / "sys")))
    assert [f.check for f in found if f.level != "ok"] == ["open"]
    assert "latency_timer" not in found[-1].remedy


@contextmanager
def slow_adapter(tmp_path):
    """Servos behind an adapter of 16 ms at the wire, and a link to their port."""
    served = tmp_path / "served.toml"
    served.write_text('schema = 1\nname = "slow"\n[servos]\nbackend = "emulated"\nusb_latency_s = 0.016\n')
    child = subprocess.Popen(
        [sys.executable, "-m", "hil.cli", "emulate", "--bench", served], stdout=subprocess.PIPE, text=True
    )
    try:
        link = tmp_path / "by-id-adapter"
        link.symlink_to(json.loads(child.stdout.readline())["servos"]["port"])
        yield link
    finally:
        child.terminate()
        child.communicate(timeout=END_S)


def test_an_adapter_as_delivered_is_recognised_at_the_wire(tmp_path):
    with slow_adapter(tmp_path) as link:
        path = tmp_path / "bench.toml"
        path.write_text(f'schema = 1\nname = "mine"\n[servos]\nport = "{link}"\n')
        found = list(examine(hil.open_bench(path), watch_s=2.5))
        reply = next(f for f in found if f.check == "reply time")
        assert reply.level == "warning"
        assert float(reply.found.split()[0]) >= 15.0
        failures = [f for f in found if f.level == "failure"]
        assert {f.check for f in failures} <= {"open", "read", "samples"}
        assert failures
        assert all("latency timer to 1 ms" in f.remedy for f in failures)
        servos = scan(str(link), MonotonicClock(), bauds=(1_000_000,))
        assert [s.operating_mode for s in servos] == [1] * 4 + [3] * 4


def test_a_servo_can_be_found_and_set_up_behind_it():
    """In virtual time."""
    config = load_bench("emulated", overrides=SERVOS_ONLY | {"servos.usb_latency_s": 0.016})
    world = build_world(config, seed=1)
    connected = connect_in_process(config, world)
    port, clock = connected.connections["servos"].values["port"], VirtualClock(world)
    clock.sleep_until_ns(300_000_000)
    found = scan(port, clock, bauds=(3_000_000,))
    assert [s.operating_mode for s in found] == [1] * 4 + [3] * 4
    changed = set_up(port, clock, baud=3_000_000, servo_id=8, new_id=20, registers={"return_delay_time": 5})
    assert changed == {"return_delay_time": (0, 5), "id": (8, 20)}
    connected.close()
