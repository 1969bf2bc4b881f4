"""IMU and camera of another robot's bag: their mounts, stamps and gravity, and the filters' use of them."""

import json
import math
import re

import numpy as np
import perfect_robot as perfect
import pytest
from perfect_robot import MAPPING, STORE
from rosbags.rosbag2 import StoragePlugin, Writer

from hil.cli import main
from hil.core.errors import ConfigError, DataError
from hil.core.geometry import quat_conjugate, quat_multiply, quat_rotate
from hil.core.signals import Status
from hil.datasets.as_cycles import to_run
from hil.datasets.rosbag import read_bag
from hil.datasets.topic_map import read_topic_map

IMU, TF, ODOMETRY = "sensor_msgs/msg/Imu", "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
SIDEWAYS = np.array([0.5, 0.5, 0.5, 0.5])
"""The IMU's x axis along the robot's y, its y along z, its z along x."""
CAMERA_M = np.array([0.15, 0.02, 0.05])
G_M_S2 = 9.81
FRAMES = """
[imu]
topic = "/chip"
frame = "chip"
[tracker]
topic = "/vio"
frame = "eye"
"""


def numbers(kind, values):
    return STORE.types[f"geometry_msgs/msg/{kind}"](*map(float, values))


def quaternion(wxyz):
    w, *xyz = wxyz
    return numbers("Quaternion", [*xyz, w])


def imu(t_s, rate, force, *, absent=0.0):
    unknown = np.zeros(9)
    rates = np.array([absent, *unknown[1:]])
    turn = quaternion((1.0, 0.0, 0.0, 0.0))
    not_there = np.array([-1.0, *unknown[1:]])
    return STORE.types[IMU](
        perfect.header(t_s),
        turn,
        not_there,
        numbers("Vector3", rate),
        rates,
        numbers("Vector3", force),
        unknown,
    )


def odometry(t_s, place, turn):
    kinds, none = STORE.types, np.zeros(36)
    pose = kinds["geometry_msgs/msg/Pose"](numbers("Point", place), quaternion(turn))
    twist = kinds["geometry_msgs/msg/Twist"](numbers("Vector3", [0] * 3), numbers("Vector3", [0] * 3))
    return kinds[ODOMETRY](
        perfect.header(t_s),
        "eye",
        kinds["geometry_msgs/msg/PoseWithCovariance"](pose, none),
        kinds["geometry_msgs/msg/TwistWithCovariance"](twist, none),
    )


def transforms(placed):
    kinds = STORE.types
    return kinds[TF](
        [
            kinds["geometry_msgs/msg/TransformStamped"](
                kinds["std_msgs/msg/Header"](perfect.header(0.0).stamp, parent),
                child,
                kinds["geometry_msgs/msg/Transform"](numbers("Vector3", at), quaternion(turn)),
            )
            for parent, child, at, turn in placed
        ]
    )


TREE = [
    ("footprint", "base_link", (0.0, 0.0, 0.1), (1.0, 0.0, 0.0, 0.0)),
    ("footprint", "plate", (0.0, 0.0, 0.2), (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))),
    # on the plate, which is turned by a right angle: back by it, then sideways
    ("plate", "chip", (0.0, 0.0, 0.0), quat_multiply((math.sqrt(0.5), 0, 0, -math.sqrt(0.5)), SIDEWAYS)),
    ("base_link", "eye", CAMERA_M, (1.0, 0.0, 0.0, 0.0)),
]


def write(folder, drive, *, late_s=0.0, tree=TREE, absent=()):
    """Bag of a drive on a floor, whose IMU lies sideways and whose camera has a frame of its own."""
    found = perfect.messages(drive)
    turning = np.gradient(drive.pose[:, 2], drive.truth_s)
    back = quat_conjugate(SIDEWAYS)
    force = quat_rotate(back, (0.0, 0.0, G_M_S2))
    for k, (t_s, (x, y, theta)) in enumerate(zip(drive.truth_s, drive.pose, strict=True)):
        rate = quat_rotate(back, (0.0, 0.0, turning[k]))
        found.append(("/chip", t_s, imu(t_s + late_s, rate, force, absent=-1.0 if k in absent else 0.0)))
        turn = (math.cos(theta / 2), 0.0, 0.0, math.sin(theta / 2))
        place = np.array([x, y, 0.0]) + quat_rotate(turn, CAMERA_M)
        found.append(("/vio", t_s, odometry(t_s, place, turn)))
    kinds = {
        "/wheels": perfect.JOINT,
        "/vicon": perfect.POSE,
        "/chip": IMU,
        "/vio": ODOMETRY,
        "/tf_static": TF,
    }
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        lanes = {t: writer.add_connection(t, kind, typestore=STORE) for t, kind in kinds.items()}
        for topic, at_s, message in sorted(
            [("/tf_static", 0.0, transforms(tree)), *found], key=lambda m: m[1]
        ):
            raw = STORE.serialize_cdr(message, kinds[topic])
            writer.write(lanes[topic], perfect.BEGIN_NS + round(at_s * 1e9), raw)
    return folder


@pytest.fixture(scope="module")
def drive():
    return perfect.drive(noise=0.0)


@pytest.fixture(scope="module")
def bag(drive, tmp_path_factory):
    return write(tmp_path_factory.mktemp("bags") / "curve_1", drive)


def mapping(folder, tables):
    path = folder / "topics.toml"
    path.write_text(MAPPING + tables)
    return path


def measured(bag, path):
    return [r.measurements for r in to_run(read_bag(bag, read_topic_map(path)), on_wall=False).records]


def test_mounts_are_those_of_the_frames(bag, drive, tmp_path):
    """The IMU's own x axis is the robot's y; the camera sees its lever where the robot turns."""
    cycles = measured(bag, mapping(tmp_path, FRAMES))
    gyro = [g for m in cycles for g in m.gyro]
    begin_s = drive.truth_s[0]
    at_s = begin_s + np.array([g.stamp.t_ns for g in gyro]) * 1e-9
    turning = np.interp(at_s, drive.truth_s, np.gradient(drive.pose[:, 2], drive.truth_s))
    np.testing.assert_allclose([g.yaw_rate_rad_s for g in gyro], turning, atol=1e-6)
    assert len(gyro) > 0.98 * len(drive.truth_s)
    seen = np.array([p.pose for m in cycles for p in m.tracker])
    first = drive.pose[0]
    np.testing.assert_allclose(seen[-1, 2], drive.pose[len(seen) - 1, 2] - first[2], atol=1e-6)
    way = drive.pose[len(seen) - 1, :2] - first[:2]
    assert np.linalg.norm(seen[-1, :2]) == pytest.approx(np.linalg.norm(way), abs=1e-6)


def test_numbers_and_frames_give_the_same(bag, tmp_path):
    by_frames = measured(bag, mapping(tmp_path, FRAMES))
    w, x, y, z = SIDEWAYS.tolist()
    by_numbers = measured(
        bag,
        mapping(
            tmp_path,
            f'[imu]\ntopic = "/chip"\nmount_rotation_wxyz = [{w}, {x}, {y}, {z}]\n'
            f'[tracker]\ntopic = "/vio"\nmount_position_m = {CAMERA_M.tolist()}\n',
        ),
    )
    for one, other in zip(by_frames, by_numbers, strict=True):
        np.testing.assert_allclose(
            [g.yaw_rate_rad_s for g in one.gyro], [g.yaw_rate_rad_s for g in other.gyro]
        )
        for pose, same in zip(one.tracker, other.tracker, strict=True):
            np.testing.assert_allclose(pose.pose, same.pose, atol=1e-9)


def test_gravity_is_the_sensors_own_direction(bag, tmp_path):
    found = read_bag(bag, read_topic_map(mapping(tmp_path, FRAMES))).sensors
    up = np.array([quat_rotate(found.parameters.imu.rotation_wxyz, s.gravity_m_s2) for s in found.imu])
    tilted = np.arccos(np.clip(up[:, 2] / np.linalg.norm(up, axis=1), -1.0, 1.0))
    assert tilted.max() < 0.01
    assert np.linalg.norm(up, axis=1) == pytest.approx(G_M_S2, abs=0.05)


def test_a_latency_is_taken_off_the_stamps(drive, tmp_path):
    late = write(tmp_path / "curve_1", drive, late_s=0.05)
    path = mapping(tmp_path, FRAMES.replace('topic = "/chip"', 'topic = "/chip"\nlatency_s = 0.05'))
    gyro = [g for m in measured(late, path) for g in m.gyro]
    at_s = drive.truth_s[0] + np.array([g.stamp.t_ns for g in gyro]) * 1e-9
    turning = np.interp(at_s, drive.truth_s, np.gradient(drive.pose[:, 2], drive.truth_s))
    np.testing.assert_allclose([g.yaw_rate_rad_s for g in gyro], turning, atol=1e-6)


def test_a_rate_that_was_not_measured_is_no_sample(drive, tmp_path):
    some = write(tmp_path / "curve_1", drive, absent=range(100, 200))
    path = mapping(tmp_path, FRAMES)
    log = read_bag(some, read_topic_map(path)).sensors
    assert sum(one.status is Status.NOT_FINITE for one in log.imu) == 100
    assert len([g for m in measured(some, path) for g in m.gyro]) < len(drive.truth_s) - 99


def test_a_clock_of_its_own_is_refused(drive, tmp_path):
    other = write(tmp_path / "curve_1", drive, late_s=-1.6e9)
    with pytest.raises(DataError, match=r"/chip is stamped from -1\.6e\+09 .* the wheels from 0 to"):
        read_bag(other, read_topic_map(mapping(tmp_path, FRAMES)))


def test_a_frame_that_is_not_there_is_named(drive, tmp_path):
    lone = write(tmp_path / "curve_1", drive, tree=TREE[2:])
    with pytest.raises(
        DataError, match="/tf_static does not connect chip with base_link; expected some of base"
    ):
        read_bag(lone, read_topic_map(mapping(tmp_path, FRAMES)))


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ('[imu]\ntopic = "/vicon"\n', r"truth\.topic and imu\.topic are both '/vicon'"),
        ('[imu]\ntopic = "/chip"\nframe = "chip"\nmount_position_m = [0, 0, 0]\n', "both give the mount"),
        ('[tracker]\ntopic = "/vio"\nlatency_s = 2.0\n', "tracker.latency_s"),
    ],
)
def test_a_mapping_that_contradicts_itself_is_refused(tmp_path, tables, said):
    with pytest.raises(ConfigError) as caught:
        read_topic_map(mapping(tmp_path, tables))
    assert any(re.search(said, problem) for problem in caught.value.problems)


def test_a_topic_of_another_type_is_refused(bag, tmp_path):
    with pytest.raises(
        DataError, match=r"/vio is of another type \(nav_msgs/msg/Odometry\); expected sensor_msgs"
    ):
        read_bag(bag, read_topic_map(mapping(tmp_path, '[imu]\ntopic = "/vio"\n')))


def test_replay_uses_them(bag, tmp_path, capsys):
    path = mapping(tmp_path, FRAMES)
    assert main(["replay", str(bag), "--topics", str(path), "--estimator", "ekf", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["sensors"] == ["wheels", "gyro", "tracker", "mocap"]
    figures = result["estimators"]["ekf"]
    assert figures["rmse_position_m"] < 5e-4
    assert figures["rmse_theta_rad"] < 1e-3
    assert figures["rejected_tracker"] < 50


TURNS = {
    "about y": "0.70710678, 0.0, 0.70710678, 0.0",
    "upside down": "0.0, 1.0, 0.0, 0.0",
    "about z": "0.70710678, 0.0, 0.0, 0.70710678",
}


@pytest.mark.parametrize(
    ("table", "turn", "said"),
    [
        ("imu", "about y", r"\[imu\]: its turning .* that about -?x agrees"),
        ("imu", "upside down", r"\[imu\]: its turning .* that about -?[xyz] agrees"),
        ("tracker", "about z", r"\[tracker\]: its way is turned by (8|9|10)\d deg about z"),
    ],
)
def test_a_wrong_mount_is_named(bag, tmp_path, capsys, table, turn, said):
    mount = [float(v) for v in TURNS[turn].split(",")]
    if table == "imu":
        mount = quat_multiply(mount, SIDEWAYS).tolist()
    topic = {"imu": "/chip", "tracker": "/vio"}[table]
    path = mapping(tmp_path, f'[{table}]\ntopic = "{topic}"\nmount_rotation_wxyz = {mount}\n')
    assert main(["replay", str(bag), "--topics", str(path), "--estimator", "odometry", "--json"]) == 2
    assert any(re.search(said, line) for line in json.loads(capsys.readouterr().out)["problems"])


def problems(bag, path, capsys, command="replay"):
    """Exit code and problems of a command on a bag."""
    code = main([command, str(bag), "--topics", str(path), "--json"])
    return code, json.loads(capsys.readouterr().out)["problems"]


@pytest.mark.parametrize("truth", [True, False])
@pytest.mark.parametrize(("given_m", "off_mm"), [((0.0, 0.0), (150, 20)), ((-0.15, -0.02), (300, 40))])
def test_a_camera_that_is_elsewhere_is_named_with_its_place(bag, tmp_path, capsys, truth, given_m, off_mm):
    path = mapping(
        tmp_path, f'[tracker]\ntopic = "/vio"\nmount_position_m = [{given_m[0]}, {given_m[1]}, 0.05]\n'
    )
    if not truth:
        path.write_text(path.read_text().replace('[truth]\ntopic = "/vicon"\n', ""))
    code, (line,) = problems(bag, path, capsys)
    found = re.search(r"\[tracker\]: by (.*) it is (-?\d+) mm in x and (-?\d+) mm in y", line)
    assert code == 2
    assert found[1] == ("the ground truth" if truth else "the wheels")
    assert (float(found[2]), float(found[3])) == pytest.approx(off_mm, abs=5)


def test_a_wrong_scale_is_named(bag, tmp_path, capsys):
    path = mapping(tmp_path, '[tracker]\ntopic = "/vio"\nframe = "eye"\nscale = 1.1\n')
    code, (line,) = problems(bag, path, capsys, "evaluate")
    assert code == 2
    assert float(re.search(r"\[tracker\]: its way is (\S+) times", line)[1]) == pytest.approx(
        1 / 1.1, abs=2e-3
    )


def test_gravity_that_was_not_removed_is_named(bag, tmp_path, capsys):
    """An IMU without an attitude of its own: its acceleration alone shows it."""
    path = mapping(tmp_path, '[imu]\ntopic = "/chip"\nframe = "chip"\ngravity = "removed"\n')
    code, (line,) = problems(bag, path, capsys)
    assert code == 2
    assert 'set gravity = "in_force"' in line


def test_evaluate_and_tune_ask_the_same(bag, tmp_path, capsys):
    mount = quat_multiply([math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0], SIDEWAYS).tolist()
    path = mapping(tmp_path, f'[imu]\ntopic = "/chip"\nmount_rotation_wxyz = {mount}\n')
    said = r"\[imu\]: its turning .* that about -?x agrees"
    assert main(["evaluate", str(bag), "--topics", str(path), "--json"]) == 2
    assert any(re.search(said, line) for line in json.loads(capsys.readouterr().out)["problems"])
    assert main(["tune", str(bag), "--topics", str(path), "--evaluations", "2", "--json"]) == 2
    assert any(re.search(said, line) for line in json.loads(capsys.readouterr().out)["problems"])


@pytest.mark.parametrize("command", ["replay", "evaluate"])
def test_topics_that_are_not_used_are_named(bag, tmp_path, capsys, command):
    path = mapping(tmp_path, '[imu]\ntopic = "/chip"\nframe = "chip"\n')
    assert main([command, str(bag), "--topics", str(path), "--json"]) == 0
    (line,) = [one for one in json.loads(capsys.readouterr().out)["warnings"] if "not used" in one]
    assert f"/vio ({ODOMETRY})" in line
    assert "/chip" not in line
    assert "/tf_static" not in line


def test_late_stamps_are_named_and_fitted(drive, tmp_path, capsys):
    late = write(tmp_path / "curve_1", drive, late_s=0.08)
    path = mapping(tmp_path, FRAMES)
    assert main(["replay", str(late), "--topics", str(path), "--estimator", "odometry", "--json"]) == 2
    (line,) = [one for one in json.loads(capsys.readouterr().out)["problems"] if "stamps" in one]
    found = re.search(r"\[imu\]: its stamps are (0\.\d+) s later .* add (0\.\d+) to its latency_s", line)
    assert float(found[1]) == pytest.approx(0.08, abs=4e-3)
    path = mapping(tmp_path, FRAMES.replace('frame = "chip"', 'frame = "chip"\nlatency_s = "fit"'))
    assert main(["replay", str(late), "--topics", str(path), "--estimator", "odometry", "--json"]) == 0
    assert any("stamps of [imu] by 0.0" in one for one in json.loads(capsys.readouterr().out)["warnings"])
    gyro = [g for m in measured(late, path) for g in m.gyro]
    at_s = drive.truth_s[0] + np.array([g.stamp.t_ns for g in gyro]) * 1e-9
    turning = np.interp(at_s, drive.truth_s, np.gradient(drive.pose[:, 2], drive.truth_s))
    assert np.abs(np.array([g.yaw_rate_rad_s for g in gyro]) - turning).max() < 5e-3


def test_a_drive_at_one_speed_does_not_determine_it(drive, tmp_path):
    """Nothing is said of stamps then, and `fit` is refused."""
    from dataclasses import replace

    still = {name: np.repeat(getattr(drive, name)[:1], len(drive.t_s), axis=0) for name in ("phi", "delta")}
    rng = np.random.default_rng(1)
    pose = drive.pose[:1] + rng.normal(0.0, 1e-4, drive.pose.shape)
    bag = write(tmp_path / "rest_1", replace(drive, pose=pose, rate=0.0 * drive.rate, **still))
    tables = FRAMES.replace('frame = "chip"', 'frame = "chip"\nlatency_s = "fit"')
    with pytest.raises(DataError, match=r"does not determine the lateness of \[imu\]"):
        read_bag(bag, read_topic_map(mapping(tmp_path, tables)))
