"""The `[servos]` section refuses what cannot be meant, and says what would be right."""

import pytest

from hil.config.servos import ServosConfig


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"baud": 123}, "within 9600 .. 4500000"),
        ({"drive_ids": (1, 2, 3, 5)}, "eight different IDs"),
        ({"steer_ids": (5, 6, 7, 253)}, "within 0 .. 252"),
        ({"watchdog_s": 0.05}, "not a multiple of 0.02"),
        ({"watchdog_s": 2.56}, "watchdog_s"),
        ({"steer_limit_rad": 4.0}, "needs steer_mode extended"),
        ({"drive_registers": {"nonsense": 1}}, "nonsense is not a register"),
        ({"drive_registers": {"indirect_data_1": 1}}, "not a register that can be set here"),
        ({"drive_registers": {"velocity_limit": 1}}, "in the EEPROM"),
        ({"steer_registers": {"goal_position": 1}}, "belongs to the driver"),
        ({"steer_registers": {"position_p_gain": 20_000}}, r"position_p_gain = 20000, expected 0\.\.16383"),
        ({"model_number": 1060}, r"no control table for model 1060 \(XL430-W250\); expected 1000 .* or 1050"),
        ({"prot": "x"}, "prot"),
        ({"port": ""}, "port"),
    ],
)
def test_a_section_that_cannot_be_meant_is_refused(values, message):
    with pytest.raises(ValueError, match=message):
        ServosConfig(**values)


def test_defaults_are_those_of_the_robot():
    config = ServosConfig()
    assert config.ids == tuple(range(1, 9))
    assert config.watchdog_count == 4
    assert ServosConfig(steer_mode="extended", steer_limit_rad=7.0).steer_limit_rad == 7.0
