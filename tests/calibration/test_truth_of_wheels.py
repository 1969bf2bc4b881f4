"""Odometry is refused as ground truth, and a path that is another motion than its name is named."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.evaluation import track_all
from hil.calibration.synthetic import MOTIONS, hidden_robot, make_set
from hil.calibration.warnings import misnamed, warnings_of
from hil.cli import main
from hil.datasets.plain_csv import write_plain
from hil.datasets.truth_of_wheels import of_wheels
from hil.robot.kinematics import WheelGeometry


@pytest.fixture(scope="module")
def healthy():
    return make_set(hidden_robot(6), 6, MOTIONS, 2)


def by_its_wheels(one, radius_share):
    wheels = WheelGeometry.nominal()
    wheels = replace(wheels, radius_m=wheels.radius_m * radius_share, steering_zero_rad=np.full(4, 0.01))
    (track,) = track_all([one], wheels, "exact", "position")
    return replace(one, truth_t_s=one.truth_t_s[0] + track.t_s, truth_pose=track.odometry)


def test_measured_poses_are_not_taken_for_odometry(healthy):
    assert [of_wheels(one) for one in healthy] == [""] * len(healthy)


@pytest.mark.parametrize("radius_share", [1.0, 1.03])
def test_odometry_of_any_geometry_is_refused_as_ground_truth(healthy, tmp_path, capsys, radius_share):
    for one in healthy[:6]:
        write_plain(tmp_path / f"{one.name}.csv", by_its_wheels(one, radius_share))
    assert main(["calibrate", str(tmp_path), "--out", str(tmp_path / "c.toml")]) == 2
    assert "computed from these wheel angles" in capsys.readouterr().err
    assert not (tmp_path / "c.toml").exists()


def test_a_path_that_is_another_motion_than_its_name_is_named(healthy):
    assert misnamed(healthy) == []
    named = [replace(one, motion=motion) for one, motion in zip(healthy[:4], MOTIONS[:4], strict=True)]
    (line,) = misnamed(named)
    wrong = [
        one.name for one, motion in zip(healthy[:4], MOTIONS[:4], strict=True) if motion != one.name[:-2]
    ]
    assert [name for name in (one.name for one in named) if f"{name} is a" in line] == wrong
    assert line in warnings_of(named)
