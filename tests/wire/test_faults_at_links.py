"""Faults in front of real devices act as those at the chips; what is sent to a device is never altered."""

from __future__ import annotations

from collections import Counter
from functools import cache
from types import SimpleNamespace

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from hil.bench.device_set_from_config import make_device_set, model_of
from hil.bench.emulated_devices import build_world, connect_in_process
from hil.bench.injection import Injection
from hil.config.loading import load_bench
from hil.core.errors import HilError
from hil.fakes.world import VirtualClock
from hil.faults import permission
from hil.faults.at_the_link import LinkFaults
from hil.faults.fault import parse_fault
from hil.faults.plan import FaultPlan
from hil.links.can_bus import CanLink
from hil.links.framing import FRAMINGS, messages
from hil.links.injection import FaultyBus, FaultyDatagrams, FaultyPort, in_front_of
from hil.links.mip.packets import Field, encode
from hil.links.udp_ports import Datagram

PROFILE, SECONDS = "emulated_floor", 6.0


def shares(
    spec: str, *, link: bool, seed: int = 3, variant: str = ""
) -> tuple[dict[str, float], list[dict[str, object]]]:
    """Share of each sample status per cycle of 10 ms, and what was injected."""
    config = config_of(variant)
    fault = parse_fault(spec)
    world = build_world(config, seed=seed, faults=[] if link else [fault])
    connected = connect_in_process(config, world)
    clock = VirtualClock(world)
    injection = Injection(config, clock, [fault] if link else [], seed)
    injection.follow(clock.now_ns)
    rig = make_device_set(
        config, clock, connected.connections, world.failures, in_front=injection.in_front_of
    )
    device, seen, width = rig.get(fault.device), Counter(), 1
    try:
        device.open()
        for t_ns in range(1_000_000_000, round(SECONDS * 1e9), 10_000_000):
            clock.sleep_until_ns(t_ns)
            if fault.device == "servos":
                device.ask()
            try:
                samples = device.read()
            except HilError:
                continue
            for sample in samples:
                states = sample.status if isinstance(sample.status, tuple) else (sample.status,)
                width = len(states)
                seen.update(state.name for state in states)
        device.close()
    finally:
        connected.close()
    cycles = 100 * (SECONDS - 1.0) * width
    return {name: count / cycles for name, count in seen.items()}, injection.report()


def differ(spec: str, variant: str = "", seeds: int = 3) -> tuple[float, int]:
    """Largest difference of a mean share between chip and link; messages hit at the link."""
    chip, link, hit = Counter(), Counter(), 0
    for seed in range(3, 3 + seeds):
        chip.update(shares(spec, link=False, seed=seed, variant=variant)[0])
        found, report = shares(spec, link=True, seed=seed, variant=variant)
        link.update(found)
        hit += report[0]["messages"]
    return max(abs(chip[name] - link[name]) / seeds for name in {*chip, *link}), hit


@pytest.mark.parametrize(
    "spec",
    [
        "servos:drop@2+2,probability=0.2",
        "servos:silent@2+1",
        "encoders:drop@2+2,probability=0.2",
        "imu:silent@2+1",
    ],
)
def test_a_fault_at_the_link_costs_what_it_costs_at_the_chip(spec):
    difference, hit = differ(spec)
    assert difference < 0.03
    assert hit > 10


VARIANTS = {
    "servos": ("emulated_floor", {}),
    "imu bno055": ("emulated_floor", {}),
    "imu microstrain": ("emulated_floor", {"imu": {"backend": "emulated", "model": "microstrain"}}),
    "encoders": ("emulated_floor", {}),
    "mocap": ("emulated_floor", {}),
    "tracker t265": ("emulated_floor", {}),
    "tracker mavlink": ("emulated_floor", {"tracker": {"backend": "emulated", "model": "mavlink"}}),
    "adhesion vesc": ("emulated", {}),
    "adhesion dronecan": ("emulated", {"adhesion": {"backend": "emulated", "model": "dronecan"}}),
    "thrust vesc": ("emulated", {"thrust": {"backend": "emulated", "model": "vesc"}}),
    "load_cells can": ("emulated", {}),
    "load_cells line": ("emulated", {"load_cells": {"backend": "emulated", "model": "hx711_line"}}),
}
"""Profile and overrides of each model of a device whose link can have faults."""
SPREADS = 24
"""Seeds of random faults of an IMU, each of whose messages counts for more than one sample."""


@cache
def config_of(variant: str):
    profile, overrides = VARIANTS.get(variant, (PROFILE, {}))
    return load_bench(profile, overrides=overrides)


def every_pair() -> list[tuple[str, str]]:
    """Every fault that both seams of a model can have: the model, and the fault's spec."""
    found = []
    for variant in VARIANTS:
        config, name = config_of(variant), variant.split()[0]
        for kind, known in permission.BY_WIRE[model_of(config, name).wire_of(config.devices()[name])].items():
            share = 0.05 if kind == "duplicate" else 0.2
            options = f",probability={share}" if "probability" in known else ""
            # other than cycle and retries: a link dates a message by when the driver reads it
            options += ",period_s=0.37" if kind == "intermittent" else ""
            # more copies or longer pauses than these fill the line of a chip, and its messages queue up
            options += ",gap_s=0.00002" if kind == "pieces" else ""
            found.append((variant, f"{name}:{kind}@2+2{options}"))
    return found


@pytest.mark.long
@pytest.mark.parametrize(("variant", "spec"), every_pair())
def test_every_fault_at_a_link_costs_what_it_costs_at_the_chip(variant, spec, record_property):
    drawn = variant.startswith("imu") and "probability" in spec
    difference, hit = differ(spec, variant, SPREADS if drawn else 3)
    record_property("difference", round(difference, 4))
    assert difference < 0.03
    assert hit > 0


BYTES = st.binary(min_size=0, max_size=40)
PACKETS = {
    "mip": lambda data: encode(0x80, [Field(0x04, data)]),
    "line": lambda data: data.hex().encode() + b"\n",
    "bno055": lambda data: bytes((0xBB, len(data))) + data,
    "dynamixel": lambda data: (
        b"\xff\xff\xfd\x00\x01" + (len(data) + 4).to_bytes(2, "little") + b"\x55\x00" + data + b"\x12\x34"
    ),
    "mavlink": lambda data: mavlink.MAVLink_statustext_message(6, data[:40]).pack(
        mavlink.MAVLink(None, 1, 2)
    ),
}


@pytest.mark.parametrize("protocol", FRAMINGS)
@given(data=st.data())
def test_messages_are_told_apart_in_whatever_pieces_they_arrive(protocol, data):
    sent = [PACKETS[protocol](one) for one in data.draw(st.lists(BYTES, min_size=1, max_size=5))]
    stream, buffer, found = b"".join(sent), bytearray(), []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        buffer += stream[:size]
        stream = stream[size:]
        found += messages(FRAMINGS[protocol], buffer)
    assert found == sent
    assert not buffer


class Port:
    """A port whose bytes wait, and which keeps what is written."""

    timeout = 0.0

    def __init__(self, data: bytes) -> None:
        self.data, self.written = data, []

    @property
    def in_waiting(self) -> int:
        return len(self.data)

    def read(self, size: int) -> bytes:
        taken, self.data = self.data[:size], self.data[size:]
        return taken

    def write(self, data: bytes) -> int:
        self.written.append(data)
        return len(data)


class Now:
    """A clock that stands until it is set."""

    t_ns = 0

    def now_ns(self) -> int:
        return self.t_ns

    def sleep_until_ns(self, t_ns: int) -> None:
        raise AssertionError("a read without timeout does not wait")


class Still(Now):
    """A clock of a computer whose bus no thread reads."""

    def wall_offset(self):
        return None


def faulty(port: Port, spec: str) -> tuple[FaultyPort, FaultPlan]:
    plan = FaultPlan([parse_fault(spec)])
    kinds = tuple(permission.BY_WIRE["serial"])
    rng = np.random.default_rng(1)
    return FaultyPort(port, LinkFaults(plan, "imu", rng, kinds, Now(), lambda: 1, "line")), plan


@pytest.mark.parametrize("kind", [k for k in permission.BY_WIRE["serial"] if k != "unplug"])
@given(commands=st.lists(st.binary(min_size=1, max_size=20), max_size=5))
def test_what_is_sent_to_the_device_is_never_altered(kind, commands):
    options = ",probability=1" if kind in ("drop", "corrupt", "truncate", "duplicate") else ""
    port = Port(b"12 34\n")
    link, _ = faulty(port, f"imu:{kind}@0{options}")
    for command in commands:
        link.write(command)
        link.read(10)
    assert port.written == commands


def test_a_cleared_plan_leaves_the_port_as_it_is():
    port = Port(b"12 34\n56 78\n")
    link, plan = faulty(port, "imu:silent@0")
    assert link.read(100) == b""
    port.data = b"90 12\n"
    plan.clear()
    assert link.in_waiting == 6
    assert link.read(100) == b"90 12\n"


class Bus:
    """A bus or UDP port whose messages wait."""

    def __init__(self, make):
        self.make, self.waiting = make, []
        self.send = self.shut = self.close = None

    def receive(self, wait_s=0.0):
        return self.make(self.waiting.pop(0)) if self.waiting else None


def frame(data):
    return can.Message(arbitration_id=1, data=data)


def datagram(data):
    return Datagram(data, ("127.0.0.1", 1), 0)


def test_on_a_shared_can_bus_only_frames_of_the_device_have_its_faults():
    table = SimpleNamespace(interface="virtual", channel="shared", bitrate=500_000, options={})
    plan, hit = FaultPlan([parse_fault("encoders:silent@0")]), []
    faults = LinkFaults(plan, "encoders", np.random.default_rng(1), ("silent",), Still(), lambda: 1)
    link = CanLink("encoders", table, Still(), lambda key: key == 0x1A0)
    with can.Bus(interface="virtual", channel="shared") as nodes:
        with in_front_of(faults):
            link.open()
        for end in (lambda: None, plan.clear):
            end()
            for frame_id, extended in ((0x1A0, False), (0x1A0, True), (0x2B0, False)):
                nodes.send(can.Message(arbitration_id=frame_id, is_extended_id=extended, data=b"12"))
            hit.append([(m.arbitration_id, m.is_extended_id) for _, m in link.take()])
        link.close()
    assert hit == [[(0x1A0, True), (0x2B0, False)], [(0x1A0, False), (0x1A0, True), (0x2B0, False)]]
    assert faults.hit == {"encoders:silent@0": 1}


@pytest.mark.parametrize(("wrapped", "make"), [(FaultyBus, frame), (FaultyDatagrams, datagram)])
def test_what_was_held_back_never_arrives_once_the_faults_are_ended(wrapped, make):
    bus, plan = Bus(make), FaultPlan([parse_fault("imu:delayed@0,delay_s=0.8")])
    now = Now()
    faults = LinkFaults(plan, "imu", np.random.default_rng(1), ("delayed",), now, lambda: 1)
    link = wrapped(bus, faults)
    bus.waiting = [b"old"]
    assert link.receive() is None
    plan.clear()
    now.t_ns = 10_000_000_000
    bus.waiting = [b"new"]
    assert bytes(link.receive().data) == b"new"
    assert link.receive() is None


def test_bytes_that_were_held_back_never_arrive_once_the_faults_are_ended():
    port = Port(b"old\n")
    link, plan = faulty(port, "imu:delayed@0,delay_s=0.8")
    assert link.read(100) == b""
    plan.clear()
    port.data = b"new\n"
    assert link.read(100) == b"new\n"
