"""The emulated devices listen to this computer only."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

LOOPBACK = "0100007F"
TWO_HOSTS = Path(__file__).with_name("two_hosts.py")
pytestmark = [
    pytest.mark.skipif(not Path("/proc/net/udp").exists(), reason="no /proc/net on this system"),
    pytest.mark.usefixtures("warm_commands"),
]


def bound_at(port):
    """Addresses that sockets of this computer are bound to at a UDP port, as the kernel writes them."""
    tables = [Path(f"/proc/net/{name}").read_text().splitlines()[1:] for name in ("udp", "udp6")]
    bound = [line.split()[1].split(":") for lines in tables for line in lines]
    return {host for host, number in bound if int(number, 16) == port}


@pytest.mark.parametrize(("device", "key"), [("mocap", "command_port"), ("tracker", "port")])
def test_emulated_devices_listen_to_this_computer_only(served, device, key):
    assert bound_at(served[device][key]) == {LOOPBACK}


def test_an_emulated_can_bus_is_bound_to_its_group(served):
    group = bytes(map(int, served["can"]["channel"].split(".")))
    assert bound_at(served["can"]["port"]) == {f"{int.from_bytes(group, sys.byteorder):08X}"}


def may_make_networks():
    """Whether this user may make networks of his own, with a cable between two."""
    if any(shutil.which(tool) is None for tool in ("unshare", "nsenter", "ip")):
        return False
    cable = ["unshare", "-rn", "ip", "link", "add", "near", "type", "veth", "peer", "name", "far"]
    return subprocess.run(cable, capture_output=True).returncode == 0


@pytest.mark.timeout(120)
def test_a_fan_obeys_no_frame_of_another_host():
    """Sent to this host or to the group; python-can's own bus hears both, so that they have arrived."""
    if not may_make_networks():
        pytest.skip("this user may make no networks of his own")
    paths = os.pathsep.join(path for path in sys.path if path)
    said = subprocess.run(
        ["unshare", "-rn", sys.executable, TWO_HOSTS],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": paths},
    )
    assert said.returncode == 0, said.stderr
    found = json.loads(said.stdout)
    assert found["foreign"] == [0.11, 0.12]
    assert found["by_them"] == 0
    assert found["own"] == [0.3]
    assert found["by_us"] > 1000
