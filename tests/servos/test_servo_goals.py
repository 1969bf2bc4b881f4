"""Goals: what is followed is clipped, and what is held is where the servos are, within one turn."""

import numpy as np
import pytest
from servo_client import MODEL, RAD_PER_COUNT, RAD_S_PER_COUNT, TABLE

from hil.config.servos import ServosConfig
from hil.core.errors import UsageError
from hil.core.signals import ServoSetpoint
from hil.drivers.servos.dynamixel.goal_values import Goals
from hil.drivers.servos.dynamixel.packets import GoalWrite
from hil.drivers.servos.dynamixel.register_map import RegisterMap

LOW, HIGH = 700, 3400


def block(**registers):
    """The registers of one servo, from address 0 on."""
    data = bytearray(147)
    for name, raw in {
        "velocity_limit": 1023,
        "min_position_limit": LOW,
        "max_position_limit": HIGH,
        "present_position": 2048,
        **registers,
    }.items():
        register = TABLE[name]
        data[register.address : register.address + register.size] = register.encode(raw)
    return bytes(data)


def goals(blocks=None, **config):
    write = GoalWrite(range(1, 9), 224)
    return Goals(ServosConfig(**config), RegisterMap(MODEL), blocks or [block()] * 8, write, "servos"), write


@pytest.mark.parametrize(
    ("register", "goal"),
    [
        (2048, 2048),
        (2048 + 4096, 2048),
        (4096 * 1000 + 3000, 3000),
        (LOW - 1, LOW),
        (-4096 + LOW, LOW),
        (HIGH + 1, HIGH),
        (-1, HIGH),
    ],
)
def test_a_servo_of_one_turn_holds_within_it_and_within_its_limits(register, goal):
    """A goal beyond one turn or the limits is ignored in silence: the servo would keep its old one."""
    registers = np.array([9000, -9000, 5, 0, register, 2048, register, 2048])
    held = goals()[0].still(registers)
    assert held.tolist() == [0, 0, 0, 0, goal, 2048, goal, 2048]


def test_limits_are_those_of_each_servo():
    blocks = [block()] * 4 + [
        block(min_position_limit=1000 + 10 * k, max_position_limit=2000 + 10 * k) for k in range(4)
    ]
    held = goals(blocks)[0].still(np.array([0, 0, 0, 0, 0, 0, 4000, 4000]))
    assert held[4:].tolist() == [1000, 1010, 2020, 2030]


@pytest.mark.parametrize("register", [2048 + 4096, -30_000, 5])
def test_a_servo_of_many_turns_holds_where_it_is(register):
    held = goals(steer_mode="extended")[0].still(np.array([1, 2, 3, 4, register, 0, 0, register]))
    assert held.tolist() == [0, 0, 0, 0, register, 0, 0, register]


def test_what_is_followed_is_clipped_and_counted_from_the_centre():
    one, write = goals(steer_limit_rad=0.6)
    lost = np.array([0, 0, 0, 0, 0, 4096, 0, 0])
    rates = np.array([2.0, -2.0, 1e3, -1e3])
    one.follow(ServoSetpoint(rates, np.array([0.5, 0.5, 2.0, -2.0])), lost)
    steps, top = round(0.5 / RAD_PER_COUNT), round(0.6 / RAD_PER_COUNT)
    speed = round(2.0 / RAD_S_PER_COUNT)
    most = min(1023, int(ServosConfig().velocity_limit_rad_s / RAD_S_PER_COUNT))
    expected = [speed, -speed, most, -most, 2048 + steps, LOW, 2048 + top, 2048 - top]
    assert one.packet() == write.packet(np.array(expected))
    one.rest()
    assert one.packet() == write.packet(np.array([0, 0, 0, 0, *expected[4:]]))


def test_a_goal_over_many_turns_ends_where_the_servo_takes_no_more():
    """Extended position mode takes 256 turns to either side, less than the counter may have lost."""
    one, write = goals(steer_mode="extended")
    most = 1_048_575
    lost = np.array([0, 0, 0, 0, 2048 - most, 2047 - most, 2048 + most, 2049 + most])
    one.follow(ServoSetpoint(np.zeros(4), np.zeros(4)), lost)
    assert one.packet() == write.packet(np.array([0, 0, 0, 0, most, most, -most, -most]))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_goals_that_are_no_numbers_leave_the_old_ones(bad):
    one, write = goals()
    rates = np.array([bad, 0, 0, 0])
    with pytest.raises(UsageError, match="not finite"):
        one.follow(ServoSetpoint(rates, np.zeros(4)), (0,) * 8)
    assert one.packet() == write.packet(np.array([0, 0, 0, 0, 2048, 2048, 2048, 2048]))
