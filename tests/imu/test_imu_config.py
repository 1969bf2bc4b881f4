"""What `[imu]` and `[encoders]` accept, and the datasheet's eight placements of the chip."""

import pytest
from pydantic import ValidationError

from hil.config.encoders import EncodersConfig
from hil.config.imu import Bno055Config
from hil.fakes.imu.bno055.sensor_physics import matrix, product, quaternion_of, remap, transpose

PRESETS = [(0x21, 4), (0x24, 0), (0x24, 6), (0x21, 2), (0x24, 3), (0x21, 1), (0x21, 7), (0x24, 5)]


def test_defaults_are_the_robot_of_the_paper():
    assert Bno055Config().mount_position_m == (0.0655, 0.0, 0.098)
    assert EncodersConfig().dbc_path.exists()


@pytest.mark.parametrize(
    ("model", "values", "what"),
    [
        (Bno055Config, {"speed": 1}, "Extra inputs"),
        (Bno055Config, {"axis_map": 0x25}, "not a permutation"),
        (Bno055Config, {"axis_map": 0x64}, "not a permutation"),
        (Bno055Config, {"axis_sign": 1}, "mirror image"),
        (Bno055Config, {"axis_map": 0x21, "axis_sign": 0}, "mirror image"),
        (Bno055Config, {"mount_rotation_wxyz": (1, 1, 0, 0)}, "norm 1.41"),
        (Bno055Config, {"fusion_mode": "euler"}, "Input should be"),
        (EncodersConfig, {"speed": 1}, "Extra inputs"),
        (EncodersConfig, {"sign": (1, 1, 2, 1)}, "-1 or 1"),
        (EncodersConfig, {"signals": ("A", "A", "B", "C")}, "four different"),
    ],
)
def test_mistakes_are_named(model, values, what):
    with pytest.raises(ValidationError, match=what):
        model(**values)


@pytest.mark.parametrize(("axis_map", "axis_sign"), PRESETS)
def test_the_eight_placements_of_the_datasheet_are_rotations(axis_map, axis_sign):
    m = remap(axis_map, axis_sign)
    q = quaternion_of(m)
    assert sum(c * c for c in q) == pytest.approx(1.0)
    for row, expected in zip(matrix(q), m, strict=True):
        assert row == pytest.approx(expected, abs=1e-12)
    assert product(m, transpose(m)) == ((1, 0, 0), (0, 1, 0), (0, 0, 1))
