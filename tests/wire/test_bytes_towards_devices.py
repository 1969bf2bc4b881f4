"""What reaches a device with faults at its link is what reaches it without; no faults, no wrapper."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest

from hil.bench.device_proxy import DeviceWithin
from hil.bench.device_set_from_config import make_device_set
from hil.bench.emulated_devices import build_world, connect_in_process
from hil.bench.injection import Injection
from hil.config.loading import load_bench
from hil.core.errors import HilError
from hil.core.signals import ServoSetpoint
from hil.fakes.can_channel import CanChannel
from hil.fakes.serial_line import SerialLine
from hil.fakes.world import VirtualClock
from hil.faults.fault import parse_fault
from hil.links.injection import FaultyPort, with_faults

SHARE = ",probability=0.3"
SYNC_WRITE = b"\x83"
MICROSTRAIN = {"imu": {"backend": "emulated", "model": "microstrain"}}


@pytest.fixture
def captured(monkeypatch):
    """Bytes and frames that reach the chips, with their times, ns."""
    found, send_bytes, send_frame = [], SerialLine.send, CanChannel.send

    def on_line(line, data, baud):
        found.append((line.world.now_ns, bytes(data)))
        return send_bytes(line, data, baud)

    def on_bus(channel, message, t_ns, *, sender=None):
        found.append((t_ns, message.arbitration_id, bytes(message.data)))
        return send_frame(channel, message, t_ns, sender=sender)

    monkeypatch.setattr(SerialLine, "send", on_line)
    monkeypatch.setattr(CanChannel, "send", on_bus)
    return found


def used(name, specs, profile, overrides):
    """Open, read and command one device for three seconds; what was injected."""
    config = load_bench(profile, overrides=overrides)
    world = build_world(config, seed=3)
    connected = connect_in_process(config, world)
    clock = VirtualClock(world)
    injection = Injection(config, clock, [parse_fault(spec) for spec in specs], 3)
    injection.follow(clock.now_ns)
    rig = make_device_set(
        config, clock, connected.connections, world.failures, in_front=injection.in_front_of
    )
    device = rig.get(name)
    device.open()
    if name == "servos":
        device.enable()
    for k, t_ns in enumerate(range(1_000_000_000, 4_000_000_000, 10_000_000)):
        clock.sleep_until_ns(t_ns)
        if name == "servos":
            device.ask()
        with contextlib.suppress(HilError):
            device.read()
        if name == "servos":
            device.command(ServoSetpoint(np.full(4, 0.01 * k), np.full(4, 0.5 + 0.001 * k)))
        elif name == "adhesion" and k % 50 == 0:
            device.set_force_n(40 + k / 100)
    wrapped = isinstance(device, DeviceWithin)
    device.close()
    connected.close()
    return wrapped, injection.report()


@pytest.mark.parametrize(
    ("fault", "name", "profile", "overrides"),
    [
        *(
            (fault, "servos", "emulated_floor", {})
            for fault in (
                "silent",
                "pieces",
                "garbage",
                "drop" + SHARE,
                "corrupt" + SHARE,
                "truncate" + SHARE,
            )
        ),
        *((kind + SHARE, "imu", "emulated_floor", MICROSTRAIN) for kind in ("drop", "corrupt", "truncate")),
        *(("delayed", name, "emulated", {}) for name in ("encoders", "load_cells")),
        *((kind + SHARE, "adhesion", "emulated", {}) for kind in ("drop", "corrupt", "duplicate")),
    ],
)
def test_what_reaches_the_device_is_what_reaches_it_without_faults(captured, fault, name, profile, overrides):
    kind, _, options = fault.partition(",")
    plain, _ = used(name, [], profile, overrides)
    expected = captured.copy()
    captured.clear()
    wrapped, (row,) = used(name, [f"{name}:{kind}@2+1" + f",{options}" * bool(options)], profile, overrides)
    if name == "servos":  # which servo is asked first depends on what has answered
        assert [d for _, d in captured if d[7:8] == SYNC_WRITE] == [
            d for _, d in expected if d[7:8] == SYNC_WRITE
        ]
        assert sum(d[7:8] == SYNC_WRITE for _, d in captured) > 300
    else:
        assert captured == expected
    assert row["messages"] > 10
    assert (plain, wrapped) == (False, True)


def test_without_a_plan_the_port_itself_is_used():
    port = object()
    assert with_faults(port, FaultyPort) is port
