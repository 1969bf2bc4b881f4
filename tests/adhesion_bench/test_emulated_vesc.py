"""The emulated motor controller at the wire, by bytes written out by hand, and how it protects itself."""

import json
from pathlib import Path

import cantools
import pytest
from worlds import ON, duty_frame, fan_world, heard, keep, send

from hil.config.adhesion import VescConfig
from hil.fakes.body_interface import JointCommand
from hil.fakes.motor_controllers import vesc_messages as vesc_frames

VECTORS = json.loads((Path(__file__).parents[1] / "golden" / "vesc_frames.json").read_text())
DBC = Path(vesc_frames.__file__).parents[2] / "links" / "vesc" / "vesc.dbc"
S = 1_000_000_000


@pytest.mark.parametrize("order", VECTORS["orders"], ids=lambda o: f"{o['packet']} {o['value']}")
def test_orders_are_understood_byte_by_byte(order):
    frame_id, data = int(order["id"], 16), bytes.fromhex(order["data"])
    assert vesc_frames.command_value(frame_id >> 8, data) == pytest.approx(order["value"])
    config = VescConfig(controller_id=min(order["controller_id"], 254))
    with fan_world(config=config, timeout_s=1.0) as (_world, clock, node, bus):
        clock.sleep_until_ns(S)
        send(bus, frame_id, data)
        clock.sleep_until_ns(S + 2_000_000)
        assert node._commanded_ns > S, "every SET_* renews the timeout"


def test_reports_have_the_bytes_that_were_written_out_by_hand():
    report = {
        r["is"]: (r["id"], bytes.fromhex(r["data"])) for r in VECTORS["reports"][:7] if r["id"][2:] == "07"
    }
    assert vesc_frames.status_1(60000, 30.0, 0.5) == report["Status"][1]
    assert vesc_frames.status_4(45.0, -5.0, 30.0)[:6] == report["Status4"][1][:6]
    assert vesc_frames.status_5(-6, 22.2) == report["Status5"][1]
    with fan_world(config=VescConfig(controller_id=7), start="off") as (_w, clock, _node, bus):
        ping = next(p for p in VECTORS["pings"] if p["controller_id"] == 7)
        send(bus, int(ping["id"], 16), bytes.fromhex(ping["data"]))
        clock.sleep_until_ns(10_000_000)
        pong = next(r for r in VECTORS["reports"] if r["is"] == "Pong" and len(r["data"]) == 4)
        assert heard(bus) == [(int(pong["id"], 16), bytes.fromhex(pong["data"]))]


def test_a_client_that_knows_only_the_dbc_reads_the_fan():
    database = cantools.database.load_file(DBC)
    with fan_world(**ON) as (_world, clock, node, bus):
        keep(bus, clock, 3.0)
        newest = {}
        for frame_id, data in heard(bus):
            message = database.get_message_by_frame_id(frame_id & ~0xFF)
            newest[frame_id >> 8] = message.decode(data)
        values = {key: float(v) for m in newest.values() for key, v in m.items()}
        found = {key.lower(): value for key, value in values.items()}
        erpm = next(v for key, v in found.items() if "erpm" in key or key == "rpm")
        assert erpm == pytest.approx(3 * node.fan.speed_rpm, rel=0.01)
        assert any(v == pytest.approx(node.fan.input_v, abs=0.1) for v in found.values())


def test_charge_and_energy_drawn_are_those_of_current_and_voltage():
    database = cantools.database.load_file(DBC)
    with fan_world(start="off", messages_1=(2, 3), messages_2=(4, 5), rate_2_hz=10.0) as (
        _world,
        clock,
        _node,
        bus,
    ):
        keep(bus, clock, 5.0)
        newest = {"ChargeDrawn": 0.0, "EnergyDrawn": 0.0}
        charge_as, energy_j, amps = 0.0, 0.0, []
        for frame_id, data in heard(bus):
            newest |= database.get_message_by_frame_id(frame_id & ~0xFF).decode(data)
            if frame_id >> 8 == 27:
                amps.append(newest["InputCurrent"])
                charge_as += 0.1 * newest["InputCurrent"]
                energy_j += 0.1 * newest["InputCurrent"] * newest["InputVoltage"]
    assert len(amps) == 50
    assert newest["ChargeDrawn"] * 3600 == pytest.approx(charge_as, rel=0.05)
    assert newest["EnergyDrawn"] * 3600 == pytest.approx(energy_j, rel=0.05)


def test_status_messages_can_be_off_as_delivered():
    with fan_world(start="off", messages_1=(), messages_2=()) as (_world, clock, _node, bus):
        keep(bus, clock, 1.0)
        assert heard(bus) == []


def test_both_rates_have_their_own_messages():
    with fan_world(**ON) as (_world, clock, _node, bus):
        clock.sleep_until_ns(2 * S)
        seen = [frame_id >> 8 for frame_id, _ in heard(bus)]
    assert 98 <= seen.count(9) <= 102
    assert 9 <= seen.count(16) <= 11
    assert seen.count(27) == seen.count(16)


def test_without_commands_the_motor_is_released_after_the_time_out_and_the_robot_falls():
    with fan_world(**{**ON, "start": "tethered"}) as (world, clock, node, bus):
        clock.sleep_until_ns(5 * S)
        world.sync_plant()
        assert world.plant.truth().adhesion_n == 45.0, "the tether holds it until the fan has carried it"
        keep(bus, clock, 3.0)
        for joint in range(8):
            world.plant.command(joint, JointCommand("velocity" if joint < 4 else "position", 0.0))
        keep(bus, clock, 1.0)
        assert world.plant.truth().adhesion_n == pytest.approx(45.0, rel=0.05)
        last_ns = clock.now_ns() - 50_000_000
        while node.fan.demand.mode != "released":
            clock.sleep_until_ns(clock.now_ns() + 1_000_000)
        assert clock.now_ns() - last_ns == pytest.approx(S, abs=3_000_000)
        assert not world.plant.truth().fallen
        clock.sleep_until_ns(clock.now_ns() + 2 * S)
        world.sync_plant()
        assert world.plant.truth().fallen


def test_a_ping_does_not_renew_the_time_out():
    with fan_world(**ON) as (_world, clock, node, bus):
        keep(bus, clock, 2.0)
        for _ in range(24):
            send(bus, 17 << 8 | 1, b"\xfe")
            clock.sleep_until_ns(clock.now_ns() + 50_000_000)
        assert node.fan.demand.mode == "released"


def test_a_time_out_of_0_lets_the_fan_run_for_ever():
    with fan_world(**ON, timeout_s=0.0) as (_world, clock, node, bus):
        keep(bus, clock, 2.0)
        clock.sleep_until_ns(clock.now_ns() + 30 * S)
        assert node.fan.force_n > 40.0


def test_commands_out_of_range_are_clipped_never_refused():
    with fan_world(**ON) as (_world, clock, node, bus):
        keep(bus, clock, 0.2, data=duty_frame(7.0))
        assert node.fan.demand.value == 0.95
        keep(bus, clock, 0.2, frame_id=1 << 8 | 1, data=(10**8).to_bytes(4, "big"))
        assert node.fan.demand.value == 100.0


def test_broadcasts_are_obeyed_and_other_controllers_orders_are_not():
    with fan_world(**ON) as (_world, clock, node, bus):
        send(bus, 0x02, duty_frame(0.5))
        clock.sleep_until_ns(5_000_000)
        assert node.fan.demand.mode == "released"
        send(bus, 0xFF, duty_frame(0.5))
        clock.sleep_until_ns(10_000_000)
        assert node.fan.demand.value == 0.5


def test_a_hot_power_stage_slows_the_fan_down_before_it_stops():
    with fan_world(**ON, ambient_c=80.0) as (_world, clock, node, bus):
        keep(bus, clock, 3.0)
        strong = node.fan.force_n
        keep(bus, clock, 120.0)
        assert node.fan.fet_c > 85.0
        assert 0.2 * strong < node.fan.force_n < 0.85 * strong


def test_a_flat_battery_slows_the_fan_down():
    with fan_world(**ON, pack_v=18.6) as (_world, clock, node, bus):
        keep(bus, clock, 3.0, duty=0.95)
        assert node.fan.input_v < 19.2
        assert node.fan.force_n < 0.75 * 45.0


@pytest.mark.parametrize("spec", ["adhesion:reset@3", "adhesion:brownout@3+0.1"])
def test_a_controller_that_restarts_obeys_the_next_command(spec):
    with fan_world(faults=[spec], **ON) as (_world, clock, node, bus):
        keep(bus, clock, 3.0)
        keep(bus, clock, 0.4)
        assert node.fan.speed_rpm < 25_000, "the motor was free while it started"
        keep(bus, clock, 2.5)
        assert node.fan.force_n > 40.0
