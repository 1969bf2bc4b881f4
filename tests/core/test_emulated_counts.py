"""Counts of the emulated servos, encoders and IMU are those of the chips."""

import numpy as np
import pytest

from hil.config.servo_models import DEFAULT_MODEL, servo_model
from hil.fakes.encoders.as5045 import encoder as as5045_chip
from hil.fakes.imu.bno055.output_sample import counts
from hil.fakes.imu.bno055.sensor_physics import Sensed
from hil.fakes.servos.dynamixel.sensing import Sensing


class Joints:
    """Joints that turn as given."""

    def __init__(self):
        self.now = np.zeros((3, 8))

    def joints(self):
        return tuple(self.now)


def test_the_servos_measure_what_their_firmware_does():
    """Counts to the nearest with dither, velocity over 76 ms that ended 12 ms ago, truncated towards zero."""
    joints, model = Joints(), servo_model(DEFAULT_MODEL)
    sensing = Sensing(joints, np.random.default_rng(1), (model,) * 8)
    dither = np.random.default_rng(1).normal(0.0, 0.25, (128, 8))
    rate_rad_s = np.linspace(-3.0, 3.0, 8)
    seen = [np.zeros(8)]
    for k in range(1, 100):
        joints.now[0] = rate_rad_s * 0.004 * k
        joints.now[2] = rate_rad_s
        seen.append(np.rint(joints.now[0] / model.rad_per_count + dither[k]))
        sensing.tick()
    found, velocities, currents = sensing.measure().tolist()
    assert found == seen[-1].tolist()
    turned = (seen[-4] - seen[-23]) * model.rad_per_count / 0.076
    assert velocities == np.trunc(turned / model.rad_s_per_count).tolist()
    assert currents == np.trunc(rate_rad_s / model.a_per_count).tolist()
    assert sensing.counts(40_000_000) == seen[-11].tolist()
    assert sensing.counts(41_000_000) == np.rint(0.75 * seen[-11] + 0.25 * seen[-12]).tolist()


@pytest.mark.parametrize("flags", [0, as5045_chip.MAG_INC, as5045_chip.COF])
def test_the_encoders_words_have_their_parity(flags):
    draws, chips = np.random.default_rng(flags), []
    for _ in range(4):
        once, twice = draws.normal(0.0, 0.1, (2, 2)).tolist()
        chips += as5045_chip.chip(once=once, twice=twice, noise_rad=0.01, sign=-1, zero_rad=draws.normal())
    chips[as5045_chip.CHIP_SIZE + as5045_chip.FLAGS] = flags
    numbers, noise = np.array(chips), draws.standard_normal((100, 5))
    for row in range(100):
        angles, more = draws.normal(0.0, 5.0, 4).tolist(), as5045_chip.OCF if row > 3 else 0
        words = as5045_chip.words(numbers, *angles, noise, row, more)
        assert words == tuple(as5045_chip.with_parity(word) for word in words)


@pytest.mark.parametrize(
    ("value", "count"),
    [(0.5, 0), (1.5, 2), (-2.5, -2), (32767.4, 32767), (1e300, 32767), (-32768.6, -32768), (-1e300, -32768)],
)
def test_a_count_is_the_nearest_that_a_register_holds(value, count):
    three = (0.0, 0.0, 0.0)
    sensed = Sensed((value, 0.0, 0.0), three, three, (1.0, 0.0, 0.0, 0.0), three, three)
    assert counts(sensed, 1.0, 1.0, 1.0, 1.0, False)[0] == count
