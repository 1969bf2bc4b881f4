"""What the emulated bus leaves out when nothing has changed, held against a bus that leaves out nothing."""

from unittest.mock import patch

from hypothesis import example, given
from hypothesis import strategies as st
from servo_client import ALL, FAST_SYNC_READ, SYNC_WRITE, TABLE, WRITE, where, word
from servo_wire import make_wire

from hil.drivers.servos.dynamixel.packets import instruction
from hil.fakes.servos.dynamixel.chip import ServoBus
from hil.fakes.servos.dynamixel.sensed_registers import LiveRegisters
from hil.fakes.servos.dynamixel.servo import Servo

IDS = (1, 2, 5)


def to_all(name, raw):
    """A sync write of one register to the servos under test."""
    register = TABLE[name]
    data = register.encode(raw)
    body = b"".join(bytes((i,)) + data for i in IDS)
    return instruction(ALL, SYNC_WRITE, word(register.address) + word(register.size) + body)


def to_one(servo_id, name, raw):
    register = TABLE[name]
    return instruction(servo_id, WRITE, word(register.address) + register.encode(raw))


def mapped(address):
    """Let the first four indirect bytes of the servos under test be those of a register."""
    places = b"".join(word(address + k) for k in range(4))
    begin = TABLE["indirect_address_1"].address
    return instruction(ALL, SYNC_WRITE, word(begin) + word(8) + b"".join(bytes((i,)) + places for i in IDS))


def by_the_map(raw):
    """A sync write of the first four indirect bytes."""
    begin, data = TABLE["indirect_data_1"].address, raw.to_bytes(4, "little")
    return instruction(ALL, SYNC_WRITE, word(begin) + word(4) + b"".join(bytes((i,)) + data for i in IDS))


RAW = st.sampled_from([0, 60])
ROTATION, PROFILE = TABLE["goal_velocity"].address, TABLE["profile_velocity"].address
TARGETS = st.sampled_from(["goal_velocity", "goal_position"])
GOALS = st.builds(to_all, TARGETS, RAW) | st.builds(by_the_map, RAW)
MAPS = st.builds(mapped, st.sampled_from([ROTATION, PROFILE]))
TORQUE = st.builds(to_all, st.just("torque_enable"), st.sampled_from([0, 1]))
REGISTERS = st.sampled_from(
    [
        ("torque_enable", 1),
        ("torque_enable", 0),
        ("bus_watchdog", 5),
        ("bus_watchdog", 0),
        ("profile_velocity", 20),
        ("profile_acceleration", 5),
        ("velocity_limit", 50),
        ("operating_mode", 1),
        ("operating_mode", 4),
        ("drive_mode", 1),
        ("id", 9),
        ("secondary_id", 2),
        ("baud_rate", 1),
        ("status_return_level", 0),
        ("goal_pwm", 100),
        ("homing_offset", 30),
    ]
)
SETTINGS = st.builds(lambda one, register: to_one(one, *register), st.sampled_from((*IDS, ALL)), REGISTERS)
READS = st.sampled_from(
    [
        instruction(ALL, FAST_SYNC_READ, word(126) + word(10) + bytes(IDS)),
        instruction(ALL, FAST_SYNC_READ, where("present_position") + bytes(range(1, 10))),
        instruction(ALL, FAST_SYNC_READ, where("present_input_voltage") + bytes(IDS)),
    ]
)
REBOOT = st.just(instruction(2, 8))
PACKETS = GOALS | SETTINGS | READS | REBOOT | MAPS | TORQUE
STEPS = st.lists(st.tuples(PACKETS, st.sampled_from([3, 3, 120, 700])), min_size=8, max_size=40)
"""Packets, and the time after each, ms."""


def driven(steps):
    """Everything that a client and the plant see of a bus, and its registers at the end."""
    wire = make_wire()
    seen = [wire.send(to_one(ALL, "torque_enable", 1))]
    for packet, wait_ms in steps:
        seen.append(wire.send(packet, wait_ns=wait_ms * 1_000_000))
        seen.append([r.ready_ns for r in wire.replies])
        seen.append(list(wire.world.plant.commands))
    return seen, wire.world.plant.position.tolist(), [bytes(s.table.data) for s in wire.bus.servos]


def always_anew(bus, t_ns, listening=ServoBus._listening):
    bus._forget()
    return listening(bus, t_ns)


@given(steps=STEPS)
@example(  # the same bytes as before go to another register
    steps=[
        (to_all("torque_enable", 0), 3),
        (mapped(ROTATION), 3),
        (to_all("torque_enable", 1), 3),
        (by_the_map(60), 3),
        (by_the_map(60), 3),
        (to_all("torque_enable", 0), 3),
        (mapped(PROFILE), 3),
        (to_all("torque_enable", 1), 3),
        (by_the_map(60), 3),
        (to_all("goal_velocity", 60), 3),
    ]
)
@example(  # a servo that answers no more
    steps=[
        (instruction(ALL, FAST_SYNC_READ, where("present_position") + bytes(IDS)), 3),
        (to_one(2, "status_return_level", 0), 3),
        (instruction(ALL, FAST_SYNC_READ, where("present_position") + bytes(IDS)), 3),
    ]
)
def test_nothing_is_left_out_that_has_an_effect(steps):
    with (
        patch.object(Servo, "repeats", lambda *_: False),
        patch.object(LiveRegisters, "motion", lambda *_: None),
        patch.object(ServoBus, "_listening", always_anew),
    ):
        wanted = driven(steps)
    assert driven(steps) == wanted
