"""Bags of other robots without ground truth: estimated and judged by their own sensors, not by errors."""

import json

import numpy as np
import perfect_robot as perfect
import pytest

from hil.cli import main
from hil.datasets.rosbag import read_bag
from hil.datasets.topic_map import read_topic_map
from hil.replay.estimator_comparison import compare_run
from hil.replay.recordings import open_recording


@pytest.fixture
def truth_left_out(tmp_path):
    path = tmp_path / "topics.toml"
    path.write_text(perfect.MAPPING.partition("[truth]")[0])
    return path


@pytest.fixture(scope="module")
def drive():
    return perfect.drive()


@pytest.fixture(scope="module")
def bag(drive, tmp_path_factory):
    return perfect.write_bag(tmp_path_factory.mktemp("bags") / "curve_1", perfect.messages(drive))


def test_the_estimate_is_that_of_the_drive(bag, drive, truth_left_out):
    """From the origin; where the robot really went is known here."""
    opened = open_recording(bag, topics=truth_left_out)
    motions = compare_run(opened.run(0), opened.bench, ("odometry", "ekf"), recorded=False)
    begin, end = np.median(drive.pose[:100], axis=0), np.median(drive.pose[-100:], axis=0)
    way, c, s = end[:2] - begin[:2], np.cos(begin[2]), np.sin(begin[2])
    true = [c * way[0] + s * way[1], c * way[1] - s * way[0], end[2] - begin[2]]
    for motion in motions.values():
        np.testing.assert_allclose(motion.estimate[-1], true, atol=2e-3)


def test_replay_gives_all_but_the_errors(bag, truth_left_out, tmp_path, capsys):
    page = tmp_path / "replay.html"
    assert main(["replay", str(bag), "--topics", str(truth_left_out), "--json", "--page", str(page)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["sensors"] == ["wheels"]
    for figures in result["estimators"].values():
        assert figures["rmse_position_m"] is None
        assert figures["nees_pose"] is None
    assert 0.0 < result["estimators"]["ekf"]["nis_wheels"] < 3.0
    assert page.read_text().count("<svg") >= 1


@pytest.mark.parametrize("command", ["evaluate", "tune", "calibrate"])
def test_what_compares_needs_it(bag, truth_left_out, capsys, command):
    assert main([command, str(bag), "--topics", str(truth_left_out)]) == 2
    assert "has no [truth]" in capsys.readouterr().err


def test_a_counter_that_wraps_is_unwound(bag, truth_left_out, drive, tmp_path):
    from dataclasses import replace

    wrapped = replace(drive, phi=(drive.phi + np.pi) % (2 * np.pi) - np.pi)
    other = perfect.write_bag(tmp_path / "curve_1", perfect.messages(wrapped))
    found = read_bag(other, read_topic_map(truth_left_out))
    rolled = found.wheel_angle_rad - found.wheel_angle_rad[0]
    np.testing.assert_allclose(rolled, drive.phi - drive.phi[0], atol=1e-9)
