"""A trajectory that begins elsewhere than the robot stands is refused before anything moves."""

import math

import numpy as np
import pytest

import hil
from hil.bench.drive_start import must_begin_where_it_stands
from hil.core.errors import TrajectoryError
from hil.procedure.tracking_errors import enable_hold
from hil.robot.trajectories import line

UP = line((0, 0, 0), (0.06, 0, 0), duration_s=1.5)


@pytest.mark.parametrize(
    "stands", [(0.0, 0.0, 0.0), (0.014, -0.014, 0.0), (0.0, 0.0, math.radians(4.9)), (0.0, 0.0, 2 * math.pi)]
)
def test_a_robot_that_was_put_there_by_hand_may_begin(stands):
    must_begin_where_it_stands(UP, np.array(stands))


@pytest.mark.parametrize(
    ("stands", "value"),
    [
        ((0.0, -0.021, 0.0), r"distance between them \(m\) is 0.021"),
        ((0.0, 0.0, math.radians(5.1)), r"angle between them \(rad\) is 0.08901"),
        ((math.nan, 0.0, 0.0), r"distance between them \(m\) is nan"),
    ],
)
def test_one_that_stands_elsewhere_is_refused_with_the_difference(stands, value):
    with pytest.raises(TrajectoryError, match=value):
        must_begin_where_it_stands(UP, np.array(stands))


def test_a_second_drive_from_the_first_ones_start_is_refused_and_nothing_moves():
    with hil.open_bench("emulated", seed=3) as bench:
        bench.drive(UP, hold_s=0.3)
        before = bench.truth().pose_body_in_wall.copy()
        with pytest.raises(TrajectoryError, match=r"the robot stands at x 0\.06"):
            bench.drive(UP)
        np.testing.assert_allclose(bench.truth().pose_body_in_wall[:2], before[:2], atol=1e-3)
        start = enable_hold(bench)
        bench.drive(line(start, start + np.array([0.03, 0, 0]), duration_s=1.0), hold_s=0.3)
        assert bench.truth().pose_body_in_wall[0] == pytest.approx(before[0] + 0.03, abs=0.005)
    assert bench.held.state == "HELD"


def test_a_start_that_is_given_is_looked_at_before_servos_are_enabled(monkeypatch):
    with hil.open_bench("emulated_floor", seed=3) as bench:
        monkeypatch.setattr(bench.devices.servos, "enable", lambda: pytest.fail("enabled"))
        with pytest.raises(TrajectoryError, match="distance between them"):
            bench.drive(UP, start_pose=(0.3, 0.0, 0.0))
