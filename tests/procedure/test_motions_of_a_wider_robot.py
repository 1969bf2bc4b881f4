"""Motions of the odometry calibration on a robot whose fit sets its wheels further out than the drawing."""

from dataclasses import replace

import numpy as np
import pytest

from hil.bench.loop_settings import motion_limits
from hil.config.loading import load_bench
from hil.core.errors import TrajectoryError
from hil.datasets.nominal_robot import Nominal
from hil.procedure.odometry_motions import MOTIONS, Sizes, followed, reference
from hil.robot.motion_limits import check

START = np.array([0.1, -0.2, 0.3])


def wider(share):
    geometry = Nominal().geometry
    return replace(geometry, x_m=share * geometry.x_m, y_m=share * geometry.y_m)


@pytest.mark.parametrize("motion", MOTIONS)
def test_it_is_driven_a_little_slower(motion):
    config = load_bench("emulated_floor")
    limits, geometry = motion_limits(config), wider(1.06)
    path = followed(motion, START, Sizes(), geometry, config)
    check(path, geometry.projection(), limits)
    if motion.startswith("rotation"):
        with pytest.raises(TrajectoryError, match="wheel speed"):
            check(reference(motion, START, Sizes()), geometry.projection(), limits)
    if motion.startswith("line"):
        assert path.duration_s == reference(motion, START, Sizes()).duration_s


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("speed_m_s", [0.118, 0.125])
def test_what_is_asked_for_stays_where_the_drawing_is_right(motion, speed_m_s):
    config, sizes = load_bench("emulated_floor"), Sizes(speed_m_s=speed_m_s)
    path = followed(motion, START, sizes, wider(1.0), config)
    assert path.to_mapping() == reference(motion, START, sizes).to_mapping()


def test_a_robot_that_cannot_be_so_wide_is_refused():
    config = load_bench("emulated_floor")
    path = followed("rotation_cw", START, Sizes(), wider(1.3), config)
    with pytest.raises(TrajectoryError, match="wheel speed"):
        check(path, wider(1.3).projection(), motion_limits(config))
