"""Bags whose drivers or clocks are at fault: what can be distinguished is, and a perfect robot stays one."""

import json
import math
from dataclasses import replace

import numpy as np
import perfect_robot as perfect
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from perfect_robot import MAPPING
from test_damaged_recordings import copied

from hil.calibration.calibrate import calibrate
from hil.calibration.evaluation import position_rmse, track
from hil.calibration.problem import make_setting
from hil.calibration.warnings import warnings_of
from hil.cli import main
from hil.core.clock import MonotonicClock
from hil.core.errors import DataError
from hil.datasets.read import read_recordings
from hil.recording.mcap_writer import McapRecorder
from hil.robot.kinematics import WheelGeometry

WHEELS = WheelGeometry.nominal()
RIGHT_M = pytest.approx(np.sqrt(2.0) * 2e-4, rel=0.3)


@pytest.fixture
def topics(tmp_path):
    path = tmp_path / "topics.toml"
    path.write_text(MAPPING)
    return path


@pytest.fixture
def read(tmp_path, topics):
    def read(found, **how):
        bag = perfect.write_bag(tmp_path / "curve_1", perfect.messages(found, **how))
        return read_recordings([bag], topics=topics)

    return read


def rmse_m(recording):
    return position_rmse(track(recording, WHEELS))


def stepped(found, at_s, by_s, topics=("/wheels", "/vicon")):
    """Messages whose stamps step back while the log goes on, of some topics."""
    for topic, at, message in perfect.messages(found):
        if topic in topics and at >= at_s:
            message.header = perfect.header(at - by_s)
        yield topic, at, message


def test_slow_ground_truth_is_no_gap(read):
    (found,) = read(perfect.drive(truth_hz=4.0))
    assert warnings_of([found]) == []


def test_a_quaternion_that_is_no_rotation_is_no_heading(read):
    """Every third message holds a position alone."""

    def pose(t_s, row):
        if round(t_s * 100) % 3:
            return perfect.pose(t_s, row)
        return perfect.pose(t_s, (row[0], row[1], 0.0), (0.01, 0.0, 0.0, 0.0))

    (found,) = read(perfect.drive(), make_pose=pose)
    assert rmse_m(found) == RIGHT_M
    assert len(found.truth_t_s) == pytest.approx(2000 * 2 / 3, abs=3)
    assert "quaternion is no rotation" in " ".join(found.repairs)


def test_positions_alone_are_refused_by_every_command(tmp_path, topics, capsys):
    found = perfect.messages(
        perfect.drive(), make_pose=lambda t_s, row: perfect.pose(t_s, (*row[:2], 0.0), (0, 0, 0, 0))
    )
    bag = perfect.write_bag(tmp_path / "curve_1", found)
    for command in (["evaluate", bag], ["calibrate", bag], ["replay", bag], ["export", bag]):
        assert main([*map(str, command), "--topics", str(topics)]) == 2
        assert "none of 2000 messages holds a heading" in capsys.readouterr().err


def test_a_topic_without_a_message_is_named_and_its_bag_left_out(tmp_path, topics, capsys):
    folder, silent = tmp_path / "bags", ("/wheels", "/vicon")
    for k in range(2):
        perfect.write_bag(folder / f"curve_{k}", perfect.messages(perfect.drive(seed=k)))
    bag = perfect.write_bag(folder / "mute_1", [])
    for command in ("evaluate", "replay", "export"):
        assert main([command, str(bag), "--topics", str(topics)]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert all(name in said.err for name in (str(bag), *silent))
    words = ["calibrate", folder, "--topics", topics, "--model", "exact", "--no-validation", "--json"]
    assert main([*map(str, words)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["recordings"], found["rejected"]) == (2, [str(bag)])
    assert all(topic in found["rejected_because"][str(bag)] for topic in silent)


def test_a_topic_with_one_message_is_refused_with_its_number(tmp_path, topics):
    found = list(perfect.messages(perfect.drive()))
    first = next(one for one in found if one[0] == "/vicon")
    bag = perfect.write_bag(
        tmp_path / "curve_1", [one for one in found if one[0] != "/vicon" or one is first]
    )
    with pytest.raises(DataError, match="only 1 usable ground-truth rows"):
        read_recordings([bag], topics=topics)


def test_a_driver_that_repeats_its_last_pose_is_left_out_and_named(read):
    whole = perfect.drive()
    frozen = (whole.truth_s > 6.0) & (whole.truth_s < 8.0)
    pose = np.array(whole.pose)
    pose[frozen] = pose[np.flatnonzero(frozen)[0] - 1]
    (found,) = read(replace(whole, pose=pose))
    assert rmse_m(found) == RIGHT_M
    assert np.max(np.abs(track(found, WHEELS).error[:, :2])) < 1.2e-3
    assert "frozen source" in " ".join(found.repairs)
    assert not any("leap" in what for what in found.repairs)


def test_a_source_that_never_goes_on_is_refused(read):
    whole = perfect.drive()
    with pytest.raises(DataError, match="repeats its last pose"):
        read(replace(whole, pose=np.where(whole.truth_s[:, None] > 6.0, whole.pose[600], whole.pose)))


def test_a_robot_that_rests_is_not_frozen(read):
    (found,) = read(perfect.drive(noise=0.0))
    assert len(found.truth_t_s) == 2000
    (of_wheels,) = warnings_of([found])
    assert "computed from these wheel angles" in of_wheels  # as it was, for want of noise


def test_wheels_that_report_rates_alone_are_integrated(tmp_path, topics):
    """Drive and steering come in messages of their own, as rates cannot say where a wheel is steered."""
    whole = perfect.drive()

    def found():
        for topic, at, message in perfect.messages(whole):
            if topic == "/wheels":
                drive, steer = (perfect.joints(at, np.zeros(4), np.zeros(4), np.zeros(4)) for _ in range(2))
                drive.name, drive.position, drive.velocity = perfect.DRIVE, np.array([]), message.velocity[:4]
                steer.name, steer.position, steer.velocity = perfect.STEER, message.position[4:], np.array([])
                yield topic, at, drive
                yield topic, at, steer
            else:
                yield topic, at, message

    (one,) = read_recordings([perfect.write_bag(tmp_path / "curve_1", found())], topics=topics)
    assert rmse_m(one) == RIGHT_M
    assert "integrated from their rates" in " ".join(one.repairs)


def test_rows_behind_a_step_back_of_stamps_are_a_recording_of_their_own(tmp_path, topics):
    bag = perfect.write_bag(tmp_path / "curve_1", stepped(perfect.drive(truth_hz=10.0), 9.0, 3.0))
    first, second = read_recordings([bag], topics=topics)
    assert [first.name, second.name] == ["curve_1 part 1", "curve_1 part 2"]
    assert first.motion == second.motion == "curve"
    assert rmse_m(first) == RIGHT_M
    assert rmse_m(second) == pytest.approx(np.sqrt(2.0) * 2e-4, rel=0.5)
    assert "step back" in " ".join(first.repairs)


def test_a_step_back_of_one_clock_alone_is_refused(tmp_path, topics):
    found = stepped(perfect.drive(), 9.0, 0.5, ("/vicon",))
    with pytest.raises(DataError, match="no common time"):
        read_recordings([perfect.write_bag(tmp_path / "curve_1", found)], topics=topics)


@pytest.mark.parametrize(("hz", "late_s"), [(100.0, -0.05), (10.0, 0.05)])
def test_ground_truth_of_another_clock_is_named_with_its_offset(read, hz, late_s):
    whole = perfect.drive(truth_hz=hz)
    found = read(replace(whole, truth_s=whole.truth_s + late_s))
    (line,) = warnings_of(found)
    assert f"0.05 s {'later' if late_s > 0 else 'earlier'}" in line


def test_a_bag_without_chunks_is_read(tmp_path, topics):
    bag = perfect.write_bag(tmp_path / "bag", perfect.messages(perfect.drive()))
    (plain,) = bag.glob("*.mcap")
    with (tmp_path / "curve_1.mcap").open("wb") as file:
        copied(plain, McapWriter(file, use_chunking=False, compression=CompressionType.NONE))
    (found,) = read_recordings([tmp_path / "curve_1.mcap"], topics=topics)
    assert rmse_m(found) == RIGHT_M


def test_bodies_as_motive_makes_them_are_brought_to_the_robot(tmp_path):
    """y upwards, the pivot 80 mm ahead and 30 mm above, turned by 0.4 rad."""
    whole = perfect.drive()
    ahead, above, turn = 0.08, 0.03, 0.4

    def pose(t_s, row):
        x, y, theta = row
        at = (x + ahead * math.cos(theta), y + ahead * math.sin(theta), above)
        half = 0.5 * (theta + turn)
        return perfect.pose(t_s, (at[0], at[2], -at[1]), (math.cos(half), 0.0, math.sin(half), 0.0))

    bag = perfect.write_bag(tmp_path / "curve_1", perfect.messages(whole, make_pose=pose))
    mount = f"[{math.cos(0.5 * turn)}, 0.0, 0.0, {math.sin(0.5 * turn)}]"
    topics = tmp_path / "topics.toml"
    topics.write_text(
        f'{MAPPING}up_axis = "y"\nmount_position_m = [{ahead}, 0.0, {above}]\nmount_rotation_wxyz = {mount}\n'
    )
    (found,) = read_recordings([bag], topics=topics)
    np.testing.assert_allclose(found.truth_pose, whole.pose, atol=1e-9)


def test_an_empty_recording_is_no_success(tmp_path, capsys):
    McapRecorder(tmp_path / "own.mcap", {}, lossless=True).close()
    for command in ("evaluate", "replay", "export"):
        assert main([command, str(tmp_path / "own.mcap")]) == 2
        assert capsys.readouterr().out == ""
    assert not (tmp_path / "own.csv").exists()


def test_a_heading_that_is_off_in_common_is_said_and_not_taken_for_steering(tmp_path, topics):
    def fitted(off_rad):
        recordings = []
        for k in range(2):
            one = perfect.drive(seed=k, sense=(-1.0) ** k)
            turned = replace(one, pose=one.pose + np.array([0.0, 0.0, off_rad]))
            name = f"turned{k}_{round(1e3 * off_rad)}"
            recordings += read_recordings(
                [perfect.write_bag(tmp_path / name, perfect.messages(turned))], topics=topics
            )
        return calibrate(
            recordings, make_setting("recommended", model="exact"), MonotonicClock(), validate=False
        )

    off, right = fitted(0.05), fitted(0.0)
    for found, said in ((off, True), (right, False)):
        assert found.to_json()["common_steering_zero_rad"] == pytest.approx(0.0, abs=2e-3)
        assert any("four steering zeros" in line for line in found.warnings) == said
