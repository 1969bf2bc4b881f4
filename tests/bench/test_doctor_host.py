"""What the machine does to a bench, on a fake `/sys` and `/proc`: each finding, and each remedy followed."""

import grp
import os
import re
import subprocess
from types import SimpleNamespace

import pytest

from hil.bench.doctor.port_findings import Host, host_findings, udev_rules
from hil.cli import main
from hil.config.loading import load_bench
from hil.links.serial_url import cannot_open


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{text}\n")


def usb_device(folder, vendor, product_id, **keys):
    for key, value in {"idVendor": vendor, "idProduct": product_id, **keys}.items():
        write(folder / key, value)


@pytest.fixture
def machine(tmp_path):
    """A U2D2 as `ttyUSB0` on a hub without supply, beside a camera at USB 2; a quiet `/proc`."""
    tree = tmp_path / "sys/devices/pci0000:00/0000:00:14.0/usb1"
    write(tree / "idVendor", "1d6b")
    hub = tree / "1-2"
    usb_device(hub, "0424", "2514", bDeviceClass="09", bmAttributes="e0", bMaxPower="2mA")
    adapter, camera = hub / "1-2.1", hub / "1-2.4"
    product = "USB <-> Serial Converter"
    usb_device(adapter, "0403", "6014", serial="FT4THV1A", product=product, speed="480", bMaxPower="90mA")
    write(adapter / "power/control", "on")
    usb_device(camera, "8087", "0b37", speed="5000", bMaxPower="400mA")
    tty = adapter / "1-2.1:1.0/ttyUSB0"
    write(tty / "latency_timer", "1")
    links = {
        "class/tty/ttyUSB0/device": tty,
        "bus/usb/devices/1-2.1": adapter,
        "bus/usb/devices/1-2.4": camera,
        "bus/usb-serial/devices/ttyUSB0": tty,
    }
    for name, target in links.items():
        link = tmp_path / "sys" / name
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(target)
    by_id = tmp_path / "dev/serial/by-id"
    by_id.mkdir(parents=True)
    port = tmp_path / "dev/ttyUSB0"
    port.touch()
    (by_id / "usb-FTDI_U2D2_FT4THV1A-if00-port0").symlink_to("../../ttyUSB0")
    (tmp_path / "proc").mkdir()
    host = Host(tmp_path / "sys", tmp_path / "proc", by_id)
    return SimpleNamespace(
        host=host, hub=hub, adapter=adapter, camera=camera, tty=tty, port=port, stable=next(by_id.iterdir())
    )


def runs(machine, pid, name, *files):
    """A program in the fake `/proc`."""
    folder = machine.host.proc / str(pid)
    write(folder / "comm", name)
    (folder / "fd").mkdir()
    for number, file in enumerate(files):
        (folder / "fd" / str(number)).symlink_to(file)


def bench(machine, port=None):
    """A real bench with servos on a port and a T265."""
    file = machine.port.parent / "bench.toml"
    write(file, f'schema = 1\nname = "mine"\n[servos]\nport = "{port or machine.stable}"\n[tracker]')
    return load_bench(file)


def findings(machine, port=None):
    return [f for f in host_findings(bench(machine, port), machine.host) if f.level != "ok"]


def only(machine, port=None):
    (found,) = findings(machine, port)
    return found


def test_a_machine_in_order_is_silent(machine):
    runs(machine, 300, "bash", "/dev/null")
    assert findings(machine) == []


def test_programs_that_grab_ports_are_named(machine):
    runs(machine, 812, "ModemManager")
    found = only(machine)
    assert (found.level, found.found.split()[0]) == ("warning", "ModemManager")


def test_a_program_that_takes_no_lock_is_named_whatever_the_port_is_called(machine):
    runs(machine, 812, "minicom", "/dev/null", machine.port)
    runs(machine, 813, "python3", "/dev/ttyUSB7")
    found = only(machine)
    assert (found.level, found.check) == ("failure", "other programs")
    assert found.found == f"{machine.stable} is open in minicom (process 812)"


def test_a_name_that_changes_is_reported_with_the_one_that_stays(machine):
    found = only(machine, machine.port)
    assert (found.check, found.remedy) == ("port name", f'port = "{machine.stable}"')


def test_a_hub_without_supply_that_is_asked_for_too_much_is_named(machine):
    write(machine.hub / "bmAttributes", "80")
    assert findings(machine) == []
    write(machine.camera / "bMaxPower", "450mA")
    found = only(machine)
    assert "hub 1-2," in found.found
    assert "540 mA" in found.found
    write(machine.hub / "bmAttributes", "c0")
    assert findings(machine) == []


def test_a_camera_on_a_slow_port_is_named(machine):
    write(machine.camera / "speed", "480")
    found = only(machine)
    assert (found.device, found.check, found.found) == ("tracker", "USB speed", "480 Mbit/s")


def follow(remedy, tmp_path):
    """Carry out what a remedy says, with a `sudo` that needs no rights."""
    shim = tmp_path / "bin" / "sudo"
    write(shim, '#!/bin/sh\nexec "$@"')
    shim.chmod(0o755)
    path = f"{shim.parent}{os.pathsep}{os.environ['PATH']}"
    subprocess.run(remedy, shell=True, check=True, capture_output=True, env=os.environ | {"PATH": path})


def test_a_port_that_may_be_suspended_is_mended_by_the_remedy(machine, tmp_path):
    write(machine.adapter / "power/control", "auto")
    found = only(machine)
    assert found.check == "USB suspend"
    follow(found.remedy, tmp_path)
    assert findings(machine) == []


def test_the_rules_are_those_of_the_adapters_that_are_plugged_in(machine):
    rules = udev_rules(bench(machine), machine.host.sysfs)
    lines = [line for line in rules.splitlines() if line and not line.startswith("#")]
    assert len(lines) == 5
    keys = r'[A-Z]+(?:\{[\w/]+\})?(?:==|\+=|=)"[^"]*"'
    assert all(re.fullmatch(rf"{keys}(?:, {keys})*", line) for line in lines)
    usb, tty = (line for line in lines if "FT4THV1A" in line)
    for line in (usb, tty):
        assert {'"0403"', '"6014"'} <= set(re.findall(r'"\w+"', line))
    assert 'ATTR{power/control}="on"' in usb
    assert {'GROUP="dialout"', 'ENV{ID_MM_PORT_IGNORE}="1"'} <= set(tty.split(", "))
    assert any('ATTR{latency_timer}="1"' in line for line in lines)
    assert sum("8087" in line or "03e7" in line for line in lines) == 2


def test_rules_are_printed_or_written(tmp_path, capsys):
    assert main(["doctor", "--fix"]) == 0
    printed = capsys.readouterr().out
    assert main(["doctor", "--fix", "--out", str(tmp_path / "60-hil.rules")]) == 0
    assert (tmp_path / "60-hil.rules").read_text() == printed
    assert main(["doctor", "--out", str(tmp_path / "other")]) == 2
    assert "--fix" in capsys.readouterr().err


def refused_at(port):
    """The remedy for a port without permission."""
    return cannot_open("servos", str(port), PermissionError(13, "denied"), expected="a servo").remedy


@pytest.mark.parametrize(
    ("group", "mode", "joins"), [("dialout", 0o660, True), ("dialout", 0o640, False), ("root", 0o660, False)]
)
def test_to_join_a_group_is_advised_only_where_it_may_use_the_port(tmp_path, monkeypatch, group, mode, joins):
    port = tmp_path / "ttyUSB0"
    port.touch()
    port.chmod(mode)
    monkeypatch.setattr(grp, "getgrgid", lambda gid: SimpleNamespace(gr_name=group))
    remedy = refused_at(port)
    if joins:
        assert remedy == f"sudo usermod -aG {group} $USER, then log in again"
    else:
        assert "--fix` prints" in remedy
        assert re.findall(r"usermod -aG (\S+)", remedy) == ["dialout"]
