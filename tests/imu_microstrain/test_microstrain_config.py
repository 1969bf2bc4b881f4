"""What `[imu]` of a MicroStrain sensor accepts."""

import pytest
from pydantic import ValidationError

from hil.config.microstrain import PACKET_BYTES, MicrostrainConfig
from hil.links.mip.fields import LAYOUTS
from hil.links.mip.packets import Field, encode


def test_the_packet_length_is_that_of_its_fields():
    fields = tuple(Field(kind, bytes(layout.size)) for kind, layout in LAYOUTS.items())
    assert len(encode(0x82, fields)) == PACKET_BYTES


def test_as_delivered_the_line_can_carry_the_rate():
    config = MicrostrainConfig()
    assert config.rate_hz * PACKET_BYTES * 10 < config.baud
    assert config.delay_s == pytest.approx(0.002 + PACKET_BYTES * 10 / 115_200)
    assert MicrostrainConfig(baud=921_600).delay_s == pytest.approx(0.003, abs=1e-4)
    assert MicrostrainConfig(latency_s=0.004).delay_s == 0.004


@pytest.mark.parametrize(
    ("given", "reported"),
    [
        ({"rate_hz": 200.0}, "at most 119 Hz, or set sensor and bench to 921600 baud"),
        ({"baud": 9600}, "needs 101200 bits per second and baud has 9600"),
        ({"rate_hz": 5.0}, "must lie within 10 .. 1000"),
        ({"rate_hz": 2000.0, "baud": 10_000_000}, "must lie within 10 .. 1000"),
        ({"latency_s": 0.5}, "must lie within 0 .. 0.1"),
        ({"mount_rotation_wxyz": (1, 1, 1, 1)}, "norm"),
        ({"axis_map": 0x24}, "axis_map"),
        ({"port": ""}, "port"),
    ],
)
def test_what_cannot_be_is_refused_with_its_reason(given, reported):
    with pytest.raises(ValidationError, match=reported):
        MicrostrainConfig(**given)
