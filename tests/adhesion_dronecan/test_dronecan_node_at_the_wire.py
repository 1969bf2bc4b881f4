"""PyPI `dronecan`'s own node at the emulated controller over multicast, by the lines of docs/adhesion.md."""

import json
import re
import threading
from pathlib import Path

import pytest
from can.interfaces.udp_multicast import UdpMulticastBus

from hil.core.clock import MonotonicClock
from hil.fakes.can_server import CanTransport
from hil.fakes.free_port import free_udp_port
from hil.fakes.server import EmulationServer

pytest.importorskip("dronecan", reason="the extra dronecan is not installed")
PAGE = Path(__file__).resolve().parents[2] / "docs" / "adhesion.md"


def shown():
    """The lines that a reader is shown."""
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.S | re.M)
    return block


@pytest.mark.filterwarnings("ignore:The 'bustype' argument is deprecated")
def test_the_lines_of_the_page_turn_the_fan(fan_world, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CAN_CONFIG", "{}")
    for name in ("recv", "flush_tx_buffer"):  # put back what the lines change
        monkeypatch.setattr(UdpMulticastBus, name, getattr(UdpMulticastBus, name))
    options = {"port": free_udp_port()}
    with fan_world() as made:
        transport = CanTransport(
            made.channel, address="239.74.164.12", device="adhesion", listens=True, options=options
        )
        server = EmulationServer(made.world, MonotonicClock(), {"adhesion": transport})
        (tmp_path / "fan.json").write_text(json.dumps(server.endpoints()), encoding="utf-8")
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            exec(compile(shown(), str(PAGE), "exec"), {})
        finally:
            server.stop()
            thread.join()
        assert made.node.fan.speed_rpm > 20_000.0
    speeds = [int(line) for line in capsys.readouterr().out.split()]
    assert len(speeds) > 30
    assert max(speeds) > 20_000
