"""The emulated devices listen to this computer only."""

from pathlib import Path

import pytest

LOOPBACK = "0100007F"


@pytest.mark.skipif(not Path("/proc/net/udp").exists(), reason="no /proc/net on this system")
@pytest.mark.parametrize(("device", "key"), [("mocap", "command_port"), ("tracker", "port")])
def test_emulated_devices_listen_to_this_computer_only(served, device, key):
    tables = [Path(f"/proc/net/{name}").read_text().splitlines()[1:] for name in ("udp", "udp6")]
    bound = [line.split()[1].split(":") for lines in tables for line in lines]
    assert {host for host, port in bound if int(port, 16) == served[device][key]} == {LOOPBACK}
