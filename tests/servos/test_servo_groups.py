"""Group instructions and timing of the emulated bus: who answers, when, and what absence does."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_client import (
    ACTION,
    ALL,
    BULK_READ,
    BULK_WRITE,
    FACTORY,
    FAST_BULK_READ,
    FAST_SYNC_READ,
    PING,
    READ,
    REBOOT,
    REG_WRITE,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    Client,
    where,
    word,
)
from servo_wire import make_wire

from hil.core.signals import Status
from hil.drivers.servos.dynamixel.packets import GroupRead, find_statuses, instruction
from hil.fakes.body_interface import JointCommand
from hil.fakes.servos.dynamixel import protocol

IDS = bytes(range(1, 9))
POSITION = where("present_position")
BYTE_NS = 10_000


def statuses(data):
    return [(servo_id, a.error, a.data) for servo_id, a in find_statuses(data) if a.status is Status.OK]


def test_a_bulk_read_answers_each_with_what_was_asked_of_it(wire):
    bench = wire()
    data = bench.send(
        instruction(
            ALL, BULK_READ, b"\x03" + where("id") + b"\x01" + where("model_number") + b"\x07" + POSITION
        )
    )
    found = statuses(data)
    assert [f[0] for f in found] == [3, 1, 7]
    assert found[0][2] == b"\x03"
    assert found[1][2] == word(1010)
    assert len(found[2][2]) == 4


def test_a_fast_bulk_read_is_one_packet(wire):
    bench = wire()
    parameters = b"\x02" + where("id") + b"\x05" + where("model_number")
    data = bench.send(instruction(ALL, FAST_BULK_READ, parameters))
    assert len(bench.replies) == 1
    assert data[:8] == b"\xff\xff\xfd\x00\xfe" + word(1 + 1 + 4 + 2 + 4) + b"\x55"
    assert data[8:11] == b"\x00\x02\x02"
    assert data[13:17] == b"\x00\x05" + word(1010)
    assert protocol.checksum(data[:-2]) == int.from_bytes(data[-2:], "little")


@pytest.mark.parametrize("fast", [False, True])
def test_an_error_of_one_servo_is_reported_beside_the_others_data(wire, fast):
    bench = wire()
    code = FAST_BULK_READ if fast else BULK_READ
    data = bench.send(instruction(ALL, code, b"\x01" + word(660) + word(4) + b"\x02" + where("id")))
    if fast:
        assert data[8:10] == bytes((protocol.ACCESS, 1))
        assert data[16:19] == b"\x00\x02\x02"
    else:
        assert statuses(data) == [(1, protocol.ACCESS, b""), (2, 0, b"\x02")]


@pytest.mark.parametrize("delay", [0, 250])
@pytest.mark.parametrize("baud", [1_000_000, 57_600])
def test_sync_read_pays_the_return_delay_of_every_servo_and_the_fast_one_once(wire, delay, baud):
    bench = wire(return_delay=delay, baud=baud)
    bench.baud = baud
    byte_ns = 10_000_000_000 // baud
    sent = len(instruction(ALL, SYNC_READ, POSITION + IDS))
    began = bench.world.now_ns + sent * byte_ns
    bench.send(instruction(ALL, SYNC_READ, POSITION + IDS), wait_ns=30_000_000)
    own_ns = 25_000 + 2_000 * delay
    expected = [began + k * (own_ns + 15 * byte_ns) + own_ns for k in range(8)]
    assert [r.ready_ns for r in bench.replies] == pytest.approx(expected, abs=10)
    began = bench.world.now_ns + sent * byte_ns
    bench.send(instruction(ALL, FAST_SYNC_READ, POSITION + IDS), wait_ns=30_000_000)
    assert [r.ready_ns for r in bench.replies] == pytest.approx([began + own_ns], abs=10)


@pytest.mark.parametrize(("behaviour", "heard"), [("silent", [1, 2]), ("skip", [1, 2, 4, 5, 6, 7, 8])])
@pytest.mark.parametrize("fast", [False, True])
def test_what_later_servos_do_when_one_is_absent_is_an_option(wire, behaviour, heard, fast):
    bench = wire(absent=frozenset({3}), after_absent=behaviour)
    bench.send(instruction(ALL, FAST_SYNC_READ if fast else SYNC_READ, POSITION + IDS))
    data = b"".join(r.data for r in bench.replies)
    group = GroupRead(IDS, 132, 4, fast=fast)
    answers = group.answers(data)
    if fast and behaviour == "skip":
        heard = [1, 2, 4, 5, 6, 7, 8]
        gaps = [
            b.ready_ns - a.ready_ns - len(a.data) * BYTE_NS
            for a, b in zip(bench.replies, bench.replies[1:], strict=False)
        ]
        assert gaps == [8 * BYTE_NS]
    assert [i for i, a in answers.items() if a.status is Status.OK] == heard


def test_a_fast_read_whose_first_servo_is_absent_has_no_head(wire):
    bench = wire(absent=frozenset({1}), after_absent="skip")
    data = bench.send(instruction(ALL, FAST_SYNC_READ, POSITION + IDS[:3]))
    assert data[:2] == b"\x00\x02"
    assert len(data) == 16
    silent = wire(absent=frozenset({1}))
    assert silent.send(instruction(ALL, FAST_SYNC_READ, POSITION + IDS[:3])) == b""


def test_old_firmware_does_not_know_the_fast_reads(wire):
    bench = wire(firmware_by_joint={2: 44}, after_absent="skip")
    data = bench.send(instruction(ALL, FAST_SYNC_READ, POSITION + IDS[1:4]))
    assert (data[9], data[17]) == (2, 4)
    assert len(data) == 8 + 8 + 8


@pytest.mark.parametrize("code", [SYNC_READ, FAST_SYNC_READ])
def test_a_servo_asked_to_answer_pings_only_is_silent_in_a_group(wire, code):
    bench = wire(after_absent="skip")
    Client(bench, 2).put("status_return_level", 0)
    assert bench.send(instruction(ALL, code, POSITION + b"\x02")) == b""
    assert statuses(bench.send(instruction(ALL, PING)))[1][0] == 2


@pytest.mark.parametrize(
    ("code", "parameters"),
    [
        (SYNC_READ, b""),
        (FAST_SYNC_READ, POSITION[:3]),
        (BULK_READ, b"\x01" + POSITION + b"\x02"),
        (FAST_BULK_READ, b"\x01\x84"),
        (SYNC_WRITE, b"\x41"),
        (BULK_WRITE, b"\x01" + word(65) + word(4) + b"\x01"),
        (SYNC_WRITE, word(65) + word(0) + b"\x01"),
    ],
)
def test_cut_group_instructions_do_nothing(wire, code, parameters):
    bench = wire()
    assert bench.send(instruction(ALL, code, parameters)) == b""
    assert Client(bench).get("led") == 0


@pytest.mark.parametrize("code", [SYNC_READ, FAST_SYNC_READ, BULK_READ, SYNC_WRITE, BULK_WRITE])
def test_group_instructions_are_for_all_or_none(wire, code):
    bench = wire()
    led = word(65) + word(1) + b"\x01"
    parameters = {SYNC_WRITE: led + b"\x01", BULK_WRITE: b"\x01" + led, BULK_READ: b"\x01" + POSITION}
    parameters = parameters.get(code, POSITION + b"\x01")
    assert bench.send(instruction(1, code, parameters)) == b""
    assert Client(bench).get("led") == 0


def test_group_writes_reach_those_named_and_spare_the_rest(wire):
    bench = wire()
    bench.send(instruction(ALL, SYNC_WRITE, word(65) + word(1) + b"\x02\x01\x05\x01\x09\x01"))
    assert [Client(bench, i).get("led") for i in range(1, 9)] == [0, 1, 0, 0, 1, 0, 0, 0]
    bench.send(
        instruction(
            ALL,
            BULK_WRITE,
            b"\x01" + word(65) + word(1) + b"\x01" + b"\x05" + word(116) + word(4) + b"\x00\x04\0\0",
        )
    )
    assert Client(bench, 1).get("led") == 1
    assert Client(bench, 5).get("goal_position") == 1024
    bench.send(instruction(ALL, WRITE, word(65) + b"\x00"))
    assert [Client(bench, i).get("led") for i in range(1, 9)] == [0] * 8


def test_servos_do_not_take_each_others_answers_for_instructions(wire):
    bench = wire()
    answer = protocol.status(1, 0, b"\x01\x02")
    assert bench.send(answer) == b""
    assert len(statuses(bench.send(answer + instruction(2, PING)))) == 1


def test_a_registered_write_starts_all_at_once(wire):
    bench = wire()
    for servo_id in (1, 2, 3):
        Client(bench, servo_id).put("torque_enable", 1)
        assert Client(bench, servo_id).put("goal_velocity", 50, REG_WRITE) == 0
    assert Client(bench, 4).do(REG_WRITE, b"\x41\x00") == (protocol.DATA_LENGTH, b"")
    assert [c.goal for c in bench.world.plant.commands[:4]] == [0, 0, 0, 0]
    assert bench.send(instruction(ALL, ACTION)) == b""
    assert [c.goal > 1 for c in bench.world.plant.commands[:4]] == [True, True, True, False]


def test_broadcasts_that_only_pings_answer(wire):
    bench = wire()
    found = statuses(bench.send(instruction(ALL, PING), wait_ns=20_000_000))
    assert found == [(i, 0, word(1010) + b"\x2e") for i in range(1, 9)]
    assert [r.ready_ns for r in bench.replies] == sorted(r.ready_ns for r in bench.replies)
    assert bench.send(instruction(ALL, READ, POSITION)) == b""
    assert bench.send(instruction(ALL, REBOOT)) == b""
    assert bench.send(instruction(ALL, PING)) == b""
    Client(bench).wait(0.2)
    assert len(statuses(bench.send(instruction(ALL, PING), wait_ns=20_000_000))) == 8


@pytest.mark.parametrize("ids", [(1, 1, 3, 4, 5, 6, 7, 8), (1, 1, 1, 4, 5, 6, 7, 8)])
def test_servos_with_the_same_id_talk_over_each_other(wire, ids):
    bench = wire(ids=ids)
    for packet in (
        instruction(1, PING),
        instruction(1, READ, POSITION),
        instruction(ALL, SYNC_READ, POSITION + b"\x01"),
        instruction(ALL, FAST_SYNC_READ, POSITION + b"\x01"),
    ):
        data = bench.send(packet)
        assert data
        assert statuses(data) == []
    assert [f[0] for f in statuses(bench.send(instruction(ALL, PING), wait_ns=20_000_000))][-4:] == [
        5,
        6,
        7,
        8,
    ]
    bench.send(instruction(ALL, FAST_SYNC_READ, POSITION + b"\x04\x01\x05"))
    data = b"".join(r.data for r in bench.replies)
    answers = GroupRead((4, 1, 5), 132, 4, fast=True).answers(data)
    assert [a.status for a in answers.values()] == [Status.OK, Status.CRC, Status.CRC]


def test_a_servo_without_power_is_silent_and_limp_and_starts_over(wire):
    bench = wire("servo.drive_FL:brownout@0.5+0.5", "servos:off@2+0.5")
    client = Client(bench)
    client.put("torque_enable", 1)
    client.wait(0.6)
    assert client.do(PING) is None
    assert bench.world.plant.commands[0] == JointCommand()
    client.wait(0.8)
    assert client.get("torque_enable") == 0
    client.wait(1.0)
    assert bench.send(instruction(ALL, PING), wait_ns=20_000_000) == b""
    client.wait(0.7)
    assert len(statuses(bench.send(instruction(ALL, PING), wait_ns=20_000_000))) == 8


NOISE = st.binary(max_size=40)
PACKETS = st.builds(
    instruction,
    st.integers(0, 254),
    st.integers(0, 255).filter(lambda code: code != protocol.STATUS),
    st.binary(max_size=30),
)


@given(pieces=st.lists(NOISE | PACKETS, max_size=6), at_once=st.booleans())
def test_no_bytes_upset_the_bus(pieces, at_once):
    bench = make_wire()
    for data in [b"".join(pieces)] if at_once else pieces:
        bench.send(data)
    bench.world.advance_to(bench.world.now_ns + 300_000_000)
    bench.baud = 57_600 if all(s.baud == 57_600 for s in bench.bus.servos) else 1_000_000
    alive = [s for s in bench.bus.servos if s.baud == bench.baud]
    if len({s.id for s in alive}) == 8:
        assert len(statuses(bench.send(instruction(ALL, PING), wait_ns=300_000_000))) == 8


def test_old_firmware_obeys_a_factory_reset_of_everything_for_everybody(wire):
    bench = wire(firmware=41)
    bench.send(instruction(ALL, FACTORY, b"\xff"), wait_ns=300_000_000)
    assert {s.id for s in bench.bus.servos} == {1}
    assert {s.baud for s in bench.bus.servos} == {57_600}
