"""What the emulated bus remembers (who hears, who answers, where a goal stands) changes no byte."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from servo_client import ALL, CLEAR, FAST_SYNC_READ, PING, READ, REBOOT, SYNC_WRITE, WRITE, where
from servo_wire import make_wire

from hil.drivers.servos.packets import GroupRead, instruction

IDS = range(1, 9)
CYCLE = GroupRead(IDS, 126, 10, fast=True).request
SOME = st.sampled_from([1, 2, 5, 8, ALL])


def written(servo_id, name, raw, size):
    at = where(name)[:2]
    return instruction(servo_id, WRITE, at + (raw & ((1 << 8 * size) - 1)).to_bytes(size, "little"))


def goals(name, values):
    at = where(name)[:2]
    parts = b"".join(
        bytes((i,)) + v.to_bytes(4, "little", signed=True) for i, v in zip(IDS, values, strict=True)
    )
    return instruction(ALL, SYNC_WRITE, at + b"\x04\x00" + parts)


def single(name, size, raws):
    return st.builds(lambda i, raw: written(i, name, raw, size), SOME, st.sampled_from(raws))


VELOCITIES = st.lists(st.sampled_from([0, 40, 41, 1023, 1024, -1023]), min_size=8, max_size=8)
POSITIONS = st.lists(st.sampled_from([2048, 2100, 0, 4095, 4096, -1]), min_size=8, max_size=8)
PACKETS = st.one_of(
    st.just(CYCLE),
    st.builds(goals, st.just("goal_velocity"), VELOCITIES),
    st.builds(goals, st.just("goal_position"), POSITIONS),
    st.just(instruction(ALL, FAST_SYNC_READ, where("present_position") + bytes(IDS))),
    single("torque_enable", 1, [0, 1]),
    single("profile_velocity", 4, [0, 200]),
    single("profile_acceleration", 4, [0, 50]),
    single("status_return_level", 1, [0, 1, 2]),
    single("velocity_limit", 4, [40, 1023]),
    single("max_position_limit", 4, [2080, 4095]),
    single("operating_mode", 1, [1, 3, 4, 16]),
    single("return_delay_time", 1, [0, 100]),
    single("bus_watchdog", 1, [0, 5]),
    single("id", 1, [1, 5, 9]),
    single("secondary_id", 1, [2, 255]),
    single("baud_rate", 1, [2, 3]),
    single("goal_pwm", 2, [300, 885]),
    st.builds(lambda i: instruction(i, REBOOT), SOME),
    st.builds(lambda i: instruction(i, PING), SOME),
    st.builds(lambda i: instruction(i, READ, where("goal_position")), SOME),
)
WAITS = st.sampled_from([1_000_000, 4_000_000, 30_000_000, 200_000_000])


CHANGES = {
    "status_return_level": (1, 0), "velocity_limit": (4, 30), "max_position_limit": (4, 2060),
    "operating_mode": (1, 16), "return_delay_time": (1, 100), "bus_watchdog": (1, 5), "id": (1, 9),
    "secondary_id": (1, 2), "baud_rate": (1, 2), "drive_mode": (1, 1), "torque_enable": (1, 0),
    "profile_velocity": (4, 200), "goal_pwm": (2, 100), "goal_velocity": (4, 7), "goal_position": (4, 2070),
}  # fmt: skip
USUAL = [
    (goals("goal_velocity", [40] * 8), 1_000_000), (CYCLE, 4_000_000),
    (goals("goal_position", [2100] * 8), 1_000_000), (CYCLE, 4_000_000),
]  # fmt: skip


def torque(on):
    return [(instruction(ALL, WRITE, where("torque_enable")[:2] + bytes((on,))), 1_000_000)]


@pytest.mark.parametrize("rested", [False, True])
@pytest.mark.parametrize("name", CHANGES)
def test_whatever_is_changed_in_one_servo_is_seen(name, rested):
    size, raw = CHANGES[name]
    change = [(written(5, name, raw, size), 1_000_000)]
    between = torque(False) + change + torque(True) if rested else change
    _alike(torque(True) + USUAL * 2 + between + USUAL * 2)


@pytest.mark.parametrize("code", [REBOOT, CLEAR])
def test_a_servo_that_starts_over_is_seen(code):
    again = [
        (instruction(5, code, b"\x01DXL\x22" if code == CLEAR else b""), 1_000_000),
        (CYCLE, 200_000_000),
    ]
    _alike(torque(True) + USUAL * 2 + again + USUAL + torque(True) + USUAL)


@given(st.lists(st.tuples(PACKETS, WAITS), min_size=5, max_size=40))
@settings(max_examples=40, deadline=None)
def test_a_bus_that_forgets_everything_at_once_answers_alike(packets):
    _alike(torque(True) + USUAL + packets + USUAL)


def _alike(packets):
    remembering, forgetting = make_wire(), make_wire()
    for packet, wait_ns in packets:
        forgetting.bus._audience.forget()
        for servo in forgetting.bus.servos:
            servo.goal = None
        assert remembering.send(packet, wait_ns) == forgetting.send(packet, wait_ns)
        assert [r.ready_ns for r in remembering.replies] == [r.ready_ns for r in forgetting.replies]
    assert remembering.world.plant.commands == forgetting.world.plant.commands
    for one, other in zip(remembering.bus.servos, forgetting.bus.servos, strict=True):
        assert _without_what_is_measured(one) == _without_what_is_measured(other)


def _without_what_is_measured(servo):
    """A servo's table; what it measures is put there only when somebody reads it."""
    measured = servo.table.layout.measured
    return bytes(servo.table.data[: measured.address]) + bytes(servo.table.data[measured.end :])
