"""PyPI `dronecan`'s own node at the emulated controller over multicast, by the lines of docs/adhesion.md."""

import json
import re
import threading
from pathlib import Path

import can
import pytest

from hil.core.clock import MonotonicClock
from hil.fakes.can_bridge import CanTransport
from hil.fakes.free_port import free_udp_port
from hil.fakes.server import EmulationServer

pytest.importorskip("dronecan", reason="the extra dronecan is not installed")
GROUP = "239.74.164.12"
PAGE = Path(__file__).resolve().parents[2] / "docs" / "adhesion.md"


def shown():
    """The lines that a reader is shown."""
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.S | re.M)
    return block


def beside(options, ended):
    """Encoders on the same bus: frames of 11 bits, of which every other looks whole to a DroneCAN node."""
    with can.Bus(interface="udp_multicast", channel=GROUP, hop_limit=0, **options) as bus:
        count = 0
        while not ended.wait(0.005):
            count += 1
            data = bytes((count % 256, 0, 0, 0, 0, 0, 0, 0xC0 if count % 2 else 0))
            bus.send(can.Message(arbitration_id=0x1A0 + count % 2, data=data, is_extended_id=False))


def test_the_lines_of_the_page_turn_the_fan_beside_encoders(fan_world, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    options, ended = {"port": free_udp_port()}, threading.Event()
    with fan_world() as made:
        transport = CanTransport(
            made.channel, address=GROUP, device="adhesion", listens=True, options=options
        )
        server = EmulationServer(made.world, MonotonicClock(), {"adhesion": transport})
        (tmp_path / "fan.json").write_text(json.dumps(server.endpoints()), encoding="utf-8")
        threads = [
            threading.Thread(target=server.run),
            threading.Thread(target=beside, args=(options, ended)),
        ]
        for thread in threads:
            thread.start()
        try:
            exec(compile(shown(), str(PAGE), "exec"), {})
        finally:
            ended.set()
            server.stop()
            for thread in threads:
                thread.join()
        assert made.node.fan.speed_rpm > 20_000.0
    speeds = [int(line) for line in capsys.readouterr().out.split()]
    assert len(speeds) > 30
    assert max(speeds) > 20_000
