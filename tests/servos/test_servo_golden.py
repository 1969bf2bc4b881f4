"""The vendor's packets byte for byte: built by the driver, understood and answered by the emulated servos."""

import json
from pathlib import Path

import numpy as np
import pytest
from servo_client import RAD_PER_COUNT

from hil.core.signals import Status
from hil.drivers.servos.dynamixel import packets
from hil.drivers.servos.dynamixel.packets import GoalWrite, GroupRead, find_statuses, instruction
from hil.drivers.servos.dynamixel.register_map import Fields
from hil.fakes.servos.dynamixel import protocol

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "dynamixel_vectors.json").read_text())
ASKED = {name: bytes.fromhex(text) for name, text in GOLDEN["instructions"].items()}
SAID = {name: bytes.fromhex(text) for name, text in GOLDEN["statuses"].items()}
PARAMETERS = {
    "ping": (1, 0x01, ""),
    "read": (1, 0x02, "84000400"),
    "write": (1, 0x03, "740000020000"),
    "sync_read": (0xFE, 0x82, "840004000102"),
    "fast_sync_read": (0xFE, 0x8A, "84000400030704"),
    "fast_bulk_read": (0xFE, 0x9A, "0384000400077C0002000492000100"),
    "backup_store": (1, 0x20, "014354524C"),
    "backup_restore": (1, 0x20, "024354524C"),
}


@pytest.mark.parametrize("name", ASKED)
def test_instructions_are_built_as_the_vendor_does(name):
    servo_id, code, parameters = PARAMETERS[name]
    assert instruction(servo_id, code, bytes.fromhex(parameters)) == ASKED[name]


@pytest.mark.parametrize("name", ASKED)
def test_instructions_are_understood_in_any_pieces(name):
    servo_id, code, parameters = PARAMETERS[name]
    wanted = protocol.Instruction(servo_id, code, bytes.fromhex(parameters))
    for size in (1, 3, 7, 100):
        parser = protocol.InstructionParser()
        found = []
        for k in range(0, len(ASKED[name]), size):
            found += parser.feed(ASKED[name][k : k + size], k * 10_000, k * 10_000)
        assert found == [wanted]


def test_a_pause_between_bytes_makes_a_servo_wait_for_a_new_header():
    parser, data = protocol.InstructionParser(), ASKED["read"]
    assert parser.feed(data[:9], 0, 0) == []
    assert parser.feed(data[9:], 1_600_000, 1_600_000) == []
    assert len(parser.feed(data, 1_700_000, 1_800_000)) == 1


def test_the_group_reads_of_the_driver_are_the_vendors():
    assert GroupRead((1, 2), 132, 4, fast=False).request == ASKED["sync_read"]
    assert GroupRead((3, 7, 4), 132, 4, fast=True).request == ASKED["fast_sync_read"]


def test_statuses_of_the_emulated_servos(wire):
    bench = wire(
        model_by_joint={0: 1030},
        firmware_by_joint={0: 38},
        steer_mode=3,
        eeprom={0: {"operating_mode": 3}},
        drive_start_counts=(166, 0, 0, 0),
    )
    assert bench.send(ASKED["ping"]) == SAID["ping"]
    assert bench.send(ASKED["write"]) == SAID["ok"]
    assert bench.bus.servos[0].table.get("goal_position") == 512
    assert bench.send(ASKED["read"]) == SAID["read"]


def test_fast_replies_of_the_emulated_servos(wire):
    bench = wire(eeprom={3: {"temperature_limit": 31}}, drive_start_counts=(0, 0, 166, 1023), seed=4)
    bench.world.plant.position[6] = 31 * RAD_PER_COUNT
    bench.world.advance_to(10_000_000)
    assert bench.send(ASKED["fast_sync_read"]) == SAID["fast_sync_read"]
    bench.bus.servos[6].write(102, (421).to_bytes(2, "little"))
    request = bytes.fromhex("03840004000766000200041F000100")
    assert bench.send(instruction(0xFE, 0x9A, request)) == SAID["fast_bulk_read"]


def test_the_driver_reads_the_vendors_replies():
    assert find_statuses(SAID["ping"])[0][1].data == bytes.fromhex("060426")
    assert find_statuses(b"\x00noise\xff" + SAID["read"] + SAID["ok"]) == [
        (1, packets.Answer(Status.OK, 0, bytes.fromhex("A6000000"))),
        (1, packets.Answer(Status.OK, 0, b"")),
    ]
    group = GroupRead((3, 7, 4), 132, 4, fast=True, fields=Fields({"position": "i"}))
    assert group.quick(SAID["fast_sync_read"]) == {"position": (166, 2079, 1023)}
    answers = group.answers(b"\xff\xff" + SAID["fast_sync_read"])
    assert [answers[i].data.hex() for i in (3, 7, 4)] == ["a6000000", "1f080000", "ff030000"]


def test_each_checksum_of_a_fast_reply_covers_all_before_it():
    group = GroupRead((3, 7, 4), 132, 4, fast=True, fields=Fields({"position": "i"}))
    data = bytearray(SAID["fast_sync_read"])
    data[20] ^= 1
    answers = group.answers(bytes(data))
    assert [answers[i].status for i in (3, 7, 4)] == [Status.OK, Status.CRC, Status.CRC]
    assert group.quick(bytes(data)) is None


def test_backup_and_restore_take_the_vendors_packets(wire):
    bench = wire()
    bench.bus.servos[0].write(78, (333).to_bytes(2, "little"))
    assert bench.send(ASKED["backup_store"]) == SAID["ok"]
    bench.bus.servos[0].write(78, (100).to_bytes(2, "little"))
    assert bench.send(ASKED["backup_restore"], wait_ns=200_000_000) == SAID["ok"]
    assert bench.bus.servos[0].table.get("velocity_p_gain") == 333
    assert bench.bus.servos[0].table.get("backup_ready") == 1


@pytest.mark.parametrize("body", ["FFFFFD", "FFFFFDFD", "FFFFFFFD", "FFFFFDFFFFFD", "00FFFFFD0000FFFFFD"])
def test_stuffing_keeps_the_header_unique_and_is_undone(body):
    body = bytes.fromhex(body)
    assert protocol.unstuff(protocol.stuff(body)) == body
    data = protocol.status(5, 0, body)
    assert data.find(protocol.HEADER[:3], 4) in (-1, data.find(b"\xff\xff\xfd\xfd", 4))
    assert find_statuses(data) == [(5, packets.Answer(Status.OK, 0, body))]
    parser = protocol.InstructionParser()
    assert parser.feed(instruction(5, 0x03, body), 0, 0) == [protocol.Instruction(5, 0x03, body)]


def test_stuffed_cycle_replies_are_read_whole(wire, servo_bench):
    """Current -1 and velocity -3 put FF FF FD into a status; the fast reply is not stuffed."""
    data = (-1).to_bytes(2, "little", signed=True) + (-3).to_bytes(4, "little", signed=True) + bytes(4)
    reply = b"".join(protocol.status(i, 0, data) for i in range(1, 9))
    group = GroupRead(range(1, 9), 126, 10, fast=False)
    assert len(reply) == group.expected + 8
    assert not group.plausible(reply[: group.expected])
    assert not group.complete(reply[:-1])
    assert group.complete(reply)
    assert all(a == packets.Answer(Status.OK, 0, data) for a in group.answers(reply).values())


def test_goals_go_out_in_one_packet_either_way(wire):
    bench = wire()
    goals = np.array([1, -2, 3, -4, 2048, 0, 4095, 1000])
    bulk = GoalWrite(range(1, 9), [104] * 4 + [116] * 4).packet(goals)
    assert len(bulk) == 82
    assert bench.send(bulk) == b""
    read = [s.table.get("goal_velocity" if s.joint < 4 else "goal_position") for s in bench.bus.servos]
    assert read == goals.tolist()
    assert len(GoalWrite(range(1, 9), 224).packet(goals)) == 54


def test_goals_that_look_like_a_header_are_stuffed(wire):
    bench = wire()
    goals = [0, 0, 0, 0, 0x00FDFFFF, 2048, 2048, 2048]
    addresses = [104] * 4 + [116] * 4
    heads = zip(range(1, 9), addresses, goals, strict=True)
    reported = b"".join(bytes((i, a, 0, 4, 0)) + goal.to_bytes(4, "little") for i, a, goal in heads)
    packet = GoalWrite(range(1, 9), addresses).packet(goals)
    assert packet == instruction(0xFE, 0x93, reported)
    assert len(packet) == 83
    assert bench.send(packet) == b""
