"""`--topics new`: a bag of unknown names, and a draft of its mapping that can be read."""

from dataclasses import replace

import numpy as np
import perfect_robot as perfect
import pytest
import test_sensors_of_bags as sensors
import test_twist_bags as twists
from perfect_robot import STORE
from rosbags.rosbag2 import StoragePlugin, Writer

from hil.cli import main
from hil.datasets.rosbag import read_bag
from hil.datasets.topic_map import read_topic_map

NAMES = {
    "ros": ("{}_wheel_joint", "{}_steer_joint", ("front_left", "rear_left", "rear_right", "front_right")),
    "short": ("drive_{}", "steering_{}", ("FL", "RL", "RR", "FR")),
    "sides first": ("motor/{}", "swivel/{}", ("left_front", "left_back", "right_back", "right_front")),
    "sides first, short": ("{}_phi", "{}_delta", ("lf", "lb", "rb", "rf")),
}


@pytest.fixture(scope="module")
def drive():
    return perfect.drive(noise=0.0)


def rename(folder, drive, drives, steers):
    """Bag with joints of other names in another order, beside the arms of a robot."""
    names = [*reversed(steers), "arm_1", *reversed(drives)]
    kinds = {"/robot/joints": perfect.JOINT, "/arm": perfect.JOINT, "/vrpn/robot": perfect.POSE}
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        lanes = {t: writer.add_connection(t, kind, typestore=STORE) for t, kind in kinds.items()}

        def put(topic, t_s, message):
            raw = STORE.serialize_cdr(message, kinds[topic])
            writer.write(lanes[topic], perfect.BEGIN_NS + round(t_s * 1e9), raw)

        for t_s, phi, delta in zip(drive.t_s, drive.phi, drive.delta, strict=True):
            at = np.array([*delta[::-1], 0.0, *phi[::-1]])
            joints = STORE.types[perfect.JOINT]
            put("/robot/joints", t_s, joints(perfect.header(t_s), names, at, np.array([]), np.array([])))
            put("/arm", t_s, joints(perfect.header(t_s), ["arm_2"], at[:1], np.array([]), np.array([])))
        for t_s, pose in zip(drive.truth_s, drive.pose, strict=True):
            put("/vrpn/robot", t_s, perfect.pose(t_s, pose))
    return folder


def drafted(bag, folder, capsys):
    assert main(["replay", str(bag), "--topics", "new"]) == 0
    path = folder / "drafted.toml"
    path.write_text(capsys.readouterr().out)
    return path


@pytest.mark.parametrize("how", NAMES)
def test_joints_are_found_by_their_corners(drive, tmp_path, capsys, how):
    driven, steered, corners = NAMES[how]
    drives, steers = ([form.format(c) for c in corners] for form in (driven, steered))
    path = drafted(rename(tmp_path / "curve_1", drive, drives, steers), tmp_path, capsys)
    found = read_bag(tmp_path / "curve_1", read_topic_map(path))
    np.testing.assert_allclose(found.wheel_angle_rad, drive.phi, atol=1e-9)
    np.testing.assert_allclose(found.steering_rad, drive.delta, atol=1e-9)
    assert found.has_truth
    assert "# not used: /arm" in path.read_text()


def test_sensors_and_their_frames_are_found(drive, tmp_path, capsys, monkeypatch):
    plain = sensors.imu

    def in_its_frame(*given, **more):
        made = plain(*given, **more)
        return replace(made, header=replace(made.header, frame_id="chip"))

    monkeypatch.setattr(sensors, "imu", in_its_frame)
    bag = sensors.write(tmp_path / "curve_1", drive)
    text = drafted(bag, tmp_path, capsys).read_text()
    assert "# [wheels] or [odometry]" in text  # joints called w1 and s1 say nothing
    path = tmp_path / "filled.toml"
    path.write_text(perfect.MAPPING + text[text.index("[imu]") :])
    by_draft = sensors.measured(bag, path)
    by_hand = sensors.measured(bag, sensors.mapping(tmp_path, sensors.FRAMES))
    for one, other in zip(by_draft, by_hand, strict=True):
        assert [g.yaw_rate_rad_s for g in one.gyro] == [g.yaw_rate_rad_s for g in other.gyro]
        assert [p.pose.tolist() for p in one.tracker] == [p.pose.tolist() for p in other.tracker]


def test_a_robot_without_joints_gets_its_twist(drive, tmp_path, capsys):
    kinds = {"/vicon": perfect.POSE, "/odom": twists.ODOMETRY}
    with Writer(tmp_path / "curve_1", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        lanes = {t: writer.add_connection(t, kind, typestore=STORE) for t, kind in kinds.items()}
        for t_s, twist in zip(drive.t_s, twists.by_wheels(drive), strict=True):
            raw = STORE.serialize_cdr(twists.message(twists.ODOMETRY, t_s, twist), twists.ODOMETRY)
            writer.write(lanes["/odom"], perfect.BEGIN_NS + round(t_s * 1e9), raw)
        for t_s, pose in zip(drive.truth_s, drive.pose, strict=True):
            raw = STORE.serialize_cdr(perfect.pose(t_s, pose), perfect.POSE)
            writer.write(lanes["/vicon"], perfect.BEGIN_NS + round(t_s * 1e9), raw)
    path = drafted(tmp_path / "curve_1", tmp_path, capsys)
    assert main(["replay", str(tmp_path / "curve_1"), "--topics", str(path), "--estimator", "ekf"]) == 0
