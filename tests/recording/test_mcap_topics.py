"""A bag that another robot's `ros2 bag record` wrote: evaluated, exported and replayed by a topic mapping."""

import contextlib
import io
import json
import sqlite3

import numpy as np
import pytest
from mcap_cases import MAPPING
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from hil.cli import main
from hil.datasets.rosbag import broken_frames
from hil.robot.kinematics import NOMINAL_RADIUS_M

RATE_HZ = 50
SPEED_M_S = 0.1


def write_bag(folder, storage=StoragePlugin.MCAP, speed_m_s=SPEED_M_S):
    """Six seconds: at rest, then straight ahead; the right wheels count backwards."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    joint, pose = types["sensor_msgs/msg/JointState"], types["nav_msgs/msg/Odometry"]
    header = types["std_msgs/msg/Header"]
    stamp = types["builtin_interfaces/msg/Time"]
    point, quaternion = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Quaternion"]
    vector, twist = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Twist"]
    with_covariance = types["geometry_msgs/msg/PoseWithCovariance"]
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        wheels = writer.add_connection("/wheels", joint.__msgtype__, typestore=store)
        truth = writer.add_connection("/vicon", pose.__msgtype__, typestore=store)
        for k in range(6 * RATE_HZ):
            t_ns = 1_000_000_000 + k * 1_000_000_000 // RATE_HZ
            head = header(stamp=stamp(sec=t_ns // 10**9, nanosec=t_ns % 10**9), frame_id="")
            x_m = speed_m_s * max(0.0, k / RATE_HZ - 1.0)
            angle = x_m / NOMINAL_RADIUS_M * np.array([1.0, 1.0, -1.0, -1.0])
            names = [f"{kind}{i}" for kind in "sw" for i in range(1, 5)]
            message = joint(
                header=head,
                name=names,
                position=np.r_[np.zeros(4), angle],
                velocity=np.array([]),
                effort=np.array([]),
            )
            writer.write(wheels, t_ns, store.serialize_cdr(message, joint.__msgtype__))
            body = types["geometry_msgs/msg/Pose"](
                position=point(x=x_m, y=0.0, z=0.1), orientation=quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
            )
            still = types["geometry_msgs/msg/TwistWithCovariance"](
                twist=twist(linear=vector(x=0.0, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0)),
                covariance=np.zeros(36),
            )
            message = pose(
                header=head,
                child_frame_id="",
                pose=with_covariance(pose=body, covariance=np.zeros(36)),
                twist=still,
            )
            writer.write(truth, t_ns, store.serialize_cdr(message, pose.__msgtype__))
    return folder


@pytest.fixture
def bag(tmp_path, topics):
    return write_bag(tmp_path / "line_x_1"), topics


def hil(*arguments):
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        code = main([*map(str, arguments), "--json"])
    return code, json.loads(out.getvalue())


def test_every_command_that_reads_recordings_takes_a_mapping(bag, tmp_path):
    folder, topics = bag
    code, table = hil("evaluate", folder, "--topics", topics)
    assert code == 0
    assert table["motions"]["line_x"]["final_position_m"] < 1e-3
    code, reported = hil("export", folder, "--topics", topics, "--out", tmp_path / "line_x_1.csv")
    assert (code, reported["rows"]) == (0, 6 * RATE_HZ)
    code, again = hil("evaluate", tmp_path / "line_x_1.csv")
    assert again["motions"]["line_x"]["final_position_m"] == pytest.approx(
        table["motions"]["line_x"]["final_position_m"], abs=1e-6
    )
    code, replayed = hil("replay", folder, "--topics", topics, "--estimator", "odometry")
    assert code == 0
    assert replayed["estimators"]["odometry"]["final_position_m"] < 5e-3


def test_a_single_file_of_the_bag_does_as_well(bag):
    folder, topics = bag
    (file,) = folder.glob("*.mcap")
    assert hil("evaluate", file, "--topics", topics)[0] == 0


def test_without_a_mapping_the_remedy_is_named(bag, capsys):
    folder, _ = bag
    (file,) = folder.glob("*.mcap")
    assert main(["evaluate", str(file)]) == 2
    assert "--topics" in capsys.readouterr().err


def database(folder, speed_m_s=SPEED_M_S):
    (file,) = write_bag(folder, StoragePlugin.SQLITE3, speed_m_s).glob("*.db3")
    return file


@pytest.mark.parametrize("described", [True, False])
def test_a_database_file_is_read_without_its_folder(tmp_path, topics, described):
    """Before Jazzy such files did not carry the definitions of their messages."""
    file = tmp_path / "line_x_4.db3"
    database(tmp_path / "line_x_4").rename(file)
    if not described:
        with contextlib.closing(sqlite3.connect(file)) as connection, connection:
            for table in ("schema", "message_definitions", "metadata"):
                connection.execute(f"DROP TABLE {table}")
    code, table = hil("evaluate", file, "--topics", topics)
    assert code == 0
    assert table["motions"]["line_x"]["final_position_m"] < 1e-3
    assert hil("export", file, "--topics", topics)[1]["rows"] == 6 * RATE_HZ
    assert hil("replay", file, "--topics", topics, "--estimator", "odometry")[0] == 0


def test_every_bag_of_a_folder_is_a_recording(tmp_path, topics):
    many = tmp_path / "many"
    many.mkdir()
    write_bag(many / "line_x_1")
    write_bag(many / "line_x_2", StoragePlugin.SQLITE3, 0.11)
    database(tmp_path / "line_x_3", 0.12).rename(many / "line_x_3.db3")
    (many / "notes").mkdir()
    code, table = hil("evaluate", many, "--topics", topics)
    assert (code, table["recordings"], table["motions"]["line_x"]["n"]) == (0, 3, 3)


@pytest.mark.parametrize("command", ["export", "replay"])
def test_a_folder_of_bags_is_refused_with_their_names_where_one_is_wanted(tmp_path, topics, capsys, command):
    many = tmp_path / "many"
    many.mkdir()
    write_bag(many / "line_x_1")
    write_bag(many / "line_x_2")
    assert main([command, str(many), "--topics", str(topics)]) == 2
    said = capsys.readouterr().err
    assert f"{many}: is a folder of 2 recordings (line_x_1, line_x_2); name one" in said
    assert main([command, str(tmp_path / "many" / "line_x_1"), "--topics", str(topics)]) == 0
    capsys.readouterr()
    (tmp_path / "none").mkdir()
    assert main([command, str(tmp_path / "none"), "--topics", str(topics)]) == 2
    assert "without a rosbag2 recording" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["evaluate", "export", "replay"])
def test_without_a_mapping_no_kind_of_bag_is_taken_for_something_else(tmp_path, capsys, command):
    many = tmp_path / "many"
    many.mkdir()
    file = database(many / "line_x_1")
    for given in (file, many / "line_x_1", many):
        assert main([command, str(given)]) == 2
        said = capsys.readouterr().err
        assert f"{given}: " in said
        assert "--topics FILE" in said
        assert "CSV" not in said


def test_a_damaged_database_is_named(tmp_path, topics, capsys):
    file = database(tmp_path / "line_x_1")
    whole = file.read_bytes()
    torn = bytearray(whole)
    torn[len(whole) // 2 : len(whole) * 3 // 4] = b"\xff" * (len(whole) * 3 // 4 - len(whole) // 2)
    for content in (
        whole[: len(whole) // 2],
        bytes(torn),
        b"",
        b"SQLite format 3\0" + bytes(90),
        b"garbage" * 50,
    ):
        file.write_bytes(content)
        assert main(["evaluate", str(file), "--topics", str(topics)]) == 2
        said = capsys.readouterr().err
        assert f"{file}: is not a readable rosbag2 recording" in said
        assert "sqlite3 FILE .recover" in said


@pytest.mark.parametrize("left", [0.3, 0.9, -5, -100])
def test_where_a_cut_file_ends_is_named(bag, tmp_path, capsys, left):
    """In its only chunk, in the index behind it, and in its last bytes."""
    folder, topics = bag
    (whole,) = folder.glob("*.mcap")
    file = tmp_path / "line_x_2.mcap"
    file.write_bytes(whole.read_bytes()[: left if left < 0 else int(left * whole.stat().st_size)])
    assert main(["evaluate", str(file), "--topics", str(topics)]) == 2
    said = capsys.readouterr().err
    assert f"{file}: is not a readable rosbag2 recording (" in said
    assert "recording ()" not in said
    assert f"it ends at byte {file.stat().st_size}, within a record" in said
    assert "mcap recover" in said


def test_a_bag_whose_mapping_turns_one_wheel_back_is_warned_of(bag, capsys):
    folder, topics = bag
    topics.write_text(MAPPING.replace("[1, 1, -1, -1]", "[-1, 1, -1, -1]"))
    code, table = hil("evaluate", folder, "--topics", topics)
    assert code == 0
    assert any("from second to second the wheels miss" in line for line in table["warnings"])


def test_a_bag_with_a_broken_frame_tree_is_read_and_named(bag, caplog):
    folder, topics = bag
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    header, time_kind = kinds["std_msgs/msg/Header"], kinds["builtin_interfaces/msg/Time"]
    vector, quaternion = kinds["geometry_msgs/msg/Vector3"], kinds["geometry_msgs/msg/Quaternion"]
    place = kinds["geometry_msgs/msg/Transform"](vector(0.0, 0.0, 0.0), quaternion(0.0, 0.0, 0.0, 1.0))
    links = [("map", "base_link"), ("odom", "wheel")]
    frames = [
        kinds["geometry_msgs/msg/TransformStamped"](header(time_kind(0, 0), parent), child, place)
        for parent, child in links
    ]
    message = kinds["tf2_msgs/msg/TFMessage"](frames)
    with Writer(folder.parent / "tf", version=9) as writer:
        connection = writer.add_connection("/tf_static", "tf2_msgs/msg/TFMessage", typestore=store)
        writer.write(connection, 0, store.serialize_cdr(message, "tf2_msgs/msg/TFMessage"))
    assert broken_frames(folder) == ()  # without transforms nothing is said
    (problem,) = broken_frames(folder.parent / "tf")
    assert problem == "2 trees that nothing connects (map, odom): record the transform between them"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hil.datasets.rosbag.broken_frames", lambda path: broken_frames(folder.parent / "tf"))
        code, _ = hil("evaluate", folder, "--topics", topics)
    assert code == 0
    assert f"{folder}: {problem}" in caplog.text
