"""The daemon of a fan that speaks DroneCAN: commands, "I am here", taking over at the fan's speed."""

import json
from pathlib import Path

import can
import pytest
from can_bus import Bus

from hil.core.clock import nanoseconds
from hil.core.errors import ConfigError
from hil.fan_daemon.bus_cycle import BusCycle
from hil.fan_daemon.fan_control import FanControl, SetPoint
from hil.fan_daemon.protocols import protocol_of
from hil.fan_daemon.spec import Spec
from hil.links.dronecan import messages as frames

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "dronecan_frames.json").read_text())
RUNNING = GOLDEN["statuses"][0]
DETAILS = {"esc_index": 2, "node_id": 120, "rpm_per_v": 1750.0}
SPEC = Spec(
    "socketcan", "can0", 42, protocol="dronecan", details=DETAILS, highest={"duty": 0.95, "erpm": 40_000.0}
)
PERIOD_NS = nanoseconds(SPEC.period_s)


def messages(vector):
    return [can.Message(arbitration_id=int(i, 16), data=bytes.fromhex(d)) for i, d in vector["frames"]]


@pytest.fixture
def kept():
    bus = Bus()
    return BusCycle(SPEC, FanControl(SPEC), lambda text: None, bus), bus


def run(cycle, start_s, duration_s):
    for t_ns in range(nanoseconds(start_s), nanoseconds(start_s + duration_s), PERIOD_NS):
        cycle.step(t_ns)


def commands(bus):
    return [frames.command_of(i, d, 2) for i, d, _ in bus.sent if i >> 8 & 0xFFFF != frames.NODE_STATUS]


def test_a_fan_that_runs_is_taken_over_at_its_speed(kept):
    cycle, bus = kept
    bus.arriving = 2 * messages(RUNNING)
    run(cycle, 0.0, 1.0)
    assert commands(bus) == [(frames.RPM_COMMAND, RUNNING["fields"]["rpm"])] * 20


def test_what_another_daemon_sends_is_taken_over_exactly(kept):
    cycle, bus = kept
    theirs = frames.command_frame(frames.RAW_COMMAND, 2, 4660, node_id=120, transfer_id=3)
    bus.arriving = [*messages(RUNNING), can.Message(arbitration_id=theirs.id, data=theirs.data)]
    run(cycle, 0.0, 1.0)
    assert commands(bus) == [(frames.RAW_COMMAND, 4660)] * 20


def test_it_says_once_a_second_that_it_is_there_and_counts_its_transfers(kept):
    cycle, bus = kept
    bus.arriving = 2 * messages(RUNNING)
    run(cycle, 0.0, 3.0)
    here = [data for i, data, _ in bus.sent if i >> 8 & 0xFFFF == frames.NODE_STATUS]
    assert [data[0] for data in here] == [0, 1, 2]
    tails = [data[-1] & 0x1F for i, data, _ in bus.sent if i >> 8 & 0xFFFF == frames.RPM_COMMAND]
    assert tails == [n % 32 for n in range(60)]
    assert all(extended for _, _, extended in bus.sent)


def test_a_duty_begins_near_the_speed_that_the_fan_has(kept):
    cycle, bus = kept
    bus.arriving = 2 * messages(RUNNING)
    run(cycle, 0.0, 0.2)
    cycle.control.set_target(nanoseconds(0.2), SetPoint("duty", 0.9))
    bus.sent.clear()
    cycle.step(nanoseconds(0.2))
    fields = RUNNING["fields"]
    ((kind, raw),) = commands(bus)
    assert kind == frames.RAW_COMMAND
    assert raw / 8191 == pytest.approx(fields["rpm"] / (1750.0 * fields["voltage"]), abs=0.03)


def test_off_ends_at_nothing_on_every_command(kept):
    cycle, bus = kept
    bus.arriving = 2 * messages(RUNNING)
    run(cycle, 0.0, 0.5)
    cycle.control.end(nanoseconds(0.5))
    run(cycle, 0.5, 6.0)
    assert cycle.control.state() == "idle"
    assert commands(bus)[-5:] == [(frames.RAW_COMMAND, 0)] * 5


def test_the_status_of_another_controller_is_not_the_fans(kept):
    cycle, bus = kept
    bus.arriving = messages(GOLDEN["statuses"][2])
    run(cycle, 0.0, 0.5)
    assert bus.sent == []


def test_a_fan_without_its_details_is_refused():
    with pytest.raises(ConfigError, match="details without esc_index, node_id, rpm_per_v"):
        protocol_of(Spec("socketcan", "can0", 42, protocol="dronecan"))
    with pytest.raises(ConfigError, match="no fan speaks 'veks'"):
        protocol_of(Spec("socketcan", "can0", 42, protocol="veks"))
