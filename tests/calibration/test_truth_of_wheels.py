"""Odometry is refused as ground truth, and a path that is another motion than its name is named."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.evaluation import track_all
from hil.calibration.synthetic import MOTIONS, hidden_robot, make_set
from hil.calibration.warnings import misnamed, warnings_of
from hil.cli import main
from hil.datasets.plain_csv import write_plain
from hil.datasets.truth_of_wheels import of_wheels, with_odometry_in_truth
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


def mixed(one, share):
    """Ground truth of which a share is odometry, as behind a filter that takes both."""
    odometry = by_its_wheels(one, 1.0)
    columns = zip(one.truth_pose.T, odometry.truth_pose.T, strict=True)
    pose = [(1.0 - share) * c + share * np.interp(one.truth_t_s, odometry.truth_t_s, o) for c, o in columns]
    return replace(one, truth_pose=np.column_stack(pose))


@pytest.mark.parametrize(("share", "named"), [(0.0, False), (0.05, False), (0.5, True), (1.0, False)])
def test_odometry_that_was_mixed_into_ground_truth_is_named(healthy, share, named):
    """Odometry alone is named elsewhere, by what it leaves."""
    found = with_odometry_in_truth([mixed(one, share) for one in healthy])
    assert {"of the rounding of the wheel angles" in " ".join(one.contradictions) for one in found} == {named}


def test_a_robot_that_trembles_is_not_accused(healthy):
    """Wheels and body move by a count to and fro from row to row: truth follows, and no odometry is in it."""
    tremble_rad = 2.0 * np.pi / 4096.0
    trembling = []
    for k, one in enumerate(healthy):
        wave = tremble_rad * np.random.default_rng(k).normal(0.0, 1.0, len(one.t_s))
        pose = one.truth_pose.copy()
        way_m = one.nominal.radius_m * np.interp(one.truth_t_s, one.t_s, wave)
        delta = np.interp(one.truth_t_s, one.t_s, one.steering_rad.mean(axis=1)) + pose[:, 2]
        pose[:, :2] += way_m[:, None] * np.column_stack([np.cos(delta), np.sin(delta)])
        wheels = np.round((one.wheel_angle_rad + wave[:, None]) / tremble_rad) * tremble_rad
        trembling.append(replace(one, truth_pose=pose, wheel_angle_rad=wheels))
    found = with_odometry_in_truth([one for one in trembling if one.motion.startswith("line")])
    assert not any(one.contradictions for one in found)
    assert any("cannot tell these apart" in note for one in found for note in one.notes)


def test_a_path_that_is_another_motion_than_its_name_is_named(healthy):
    assert misnamed(healthy) == []
    named = [replace(one, motion=motion) for one, motion in zip(healthy[:4], MOTIONS[:4], strict=True)]
    (line,) = misnamed(named)
    wrong = [
        one.name for one, motion in zip(healthy[:4], MOTIONS[:4], strict=True) if motion != one.name[:-2]
    ]
    assert [name for name in (one.name for one in named) if f"{name} is a" in line] == wrong
    assert line in warnings_of(named)
