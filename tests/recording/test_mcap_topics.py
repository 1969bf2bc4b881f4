"""A bag that another robot's `ros2 bag record` wrote: evaluated, exported and replayed by a topic mapping.

Packed ones are read as plain ones; damaged ones are named.
"""

import contextlib
import io
import json
import re
import sqlite3
from dataclasses import replace

import numpy as np
import pytest
import zstandard
from mcap_cases import MAPPING
from perfect_robot import BEGIN_NS, JOINT, STORE, header, joints, pose
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from hil.cli import main
from hil.core.errors import DataError
from hil.datasets.frame_tree import broken_frames
from hil.datasets.rosbag import read_bag
from hil.datasets.topic_map import read_topic_map
from hil.robot.kinematics import NOMINAL_RADIUS_M

RATE_HZ = 50
SPEED_M_S = 0.1
ODOMETRY = "nav_msgs/msg/Odometry"


def write_bag(folder, storage=StoragePlugin.MCAP, speed_m_s=SPEED_M_S):
    """Six seconds: at rest, then straight ahead; the right wheels count backwards."""
    kinds = STORE.types
    still = kinds["geometry_msgs/msg/Twist"](*[kinds["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)] * 2)
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        wheels = writer.add_connection("/wheels", JOINT, typestore=STORE)
        truth = writer.add_connection("/vicon", ODOMETRY, typestore=STORE)
        for k in range(6 * RATE_HZ):
            t_s = k / RATE_HZ
            x_m = speed_m_s * max(0.0, t_s - 1.0)
            angle = x_m / NOMINAL_RADIUS_M * np.array([1.0, 1.0, -1.0, -1.0])
            message = joints(t_s, angle, np.zeros(4), np.zeros(4))
            message.velocity = np.array([])
            writer.write(wheels, BEGIN_NS + round(t_s * 1e9), STORE.serialize_cdr(message, JOINT))
            place = pose(t_s, (x_m, 0.0, 0.1), (1.0, 0.0, 0.0, 0.0)).pose
            body = kinds["geometry_msgs/msg/PoseWithCovariance"](place, np.zeros(36))
            moves = kinds["geometry_msgs/msg/TwistWithCovariance"](still, np.zeros(36))
            message = kinds[ODOMETRY](header(t_s), "", body, moves)
            writer.write(truth, BEGIN_NS + round(t_s * 1e9), STORE.serialize_cdr(message, ODOMETRY))
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
    (file,) = folder.glob("*.mcap")
    assert hil("evaluate", file, "--topics", topics)[0] == 0


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


def test_every_bag_of_a_folder_is_a_recording(tmp_path, topics):
    many = tmp_path / "many"
    many.mkdir()
    write_bag(many / "line_x_1")
    write_bag(many / "line_x_2", StoragePlugin.SQLITE3, 0.11)
    database(tmp_path / "line_x_3", 0.12).rename(many / "line_x_3.db3")
    (many / "notes").mkdir()
    code, table = hil("evaluate", many, "--topics", topics)
    assert (code, table["recordings"], table["motions"]["line_x"]["n"]) == (0, 3, 3)


def test_a_folder_of_bags_is_refused_with_their_names_where_one_is_wanted(tmp_path, topics, capsys):
    many, none = tmp_path / "many", tmp_path / "none"
    many.mkdir()
    none.mkdir()
    write_bag(many / "line_x_1")
    write_bag(many / "line_x_2")
    for command in ("export", "replay"):
        assert main([command, str(many), "--topics", str(topics)]) == 2
        assert "is a folder of 2 recordings (line_x_1, line_x_2)" in capsys.readouterr().err
        assert main([command, str(none), "--topics", str(topics)]) == 2
        assert "without a rosbag2 recording" in capsys.readouterr().err


def test_without_a_mapping_no_kind_of_bag_is_taken_for_something_else(tmp_path, capsys):
    many = tmp_path / "many"
    many.mkdir()
    (mcap,) = write_bag(tmp_path / "line_x_2").glob("*.mcap")
    file = database(many / "line_x_1")
    for command in ("evaluate", "export", "replay"):
        for given in (mcap, file, many / "line_x_1", many):
            assert main([command, str(given)]) == 2
            said = capsys.readouterr().err
            assert f"{given}: " in said
            assert "--topics FILE" in said


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


@pytest.mark.parametrize("left", [0.3, -100])
def test_where_a_cut_file_ends_is_named(bag, tmp_path, capsys, left):
    """In its only chunk, and in the index behind it."""
    folder, topics = bag
    (whole,) = folder.glob("*.mcap")
    file = tmp_path / "line_x_2.mcap"
    file.write_bytes(whole.read_bytes()[: left if left < 0 else int(left * whole.stat().st_size)])
    assert main(["evaluate", str(file), "--topics", str(topics)]) == 2
    said = capsys.readouterr().err
    assert f"{file}: is not a readable rosbag2 recording (" in said
    assert "recording ()" not in said
    assert "it ends early at byte" in said
    assert str(file.stat().st_size) in said
    assert "mcap recover" in said


def test_a_bag_whose_mapping_turns_one_wheel_back_does_not_end_with_0(bag, capsys):
    folder, topics = bag
    topics.write_text(MAPPING.replace("[1, 1, -1, -1]", "[-1, 1, -1, -1]"))
    code, _ = hil("evaluate", folder, "--topics", topics)
    assert code == 2
    assert "the FL wheel (phi1, delta1) alone misses 200 % of its way" in capsys.readouterr().err


def test_a_bag_with_a_broken_frame_tree_is_read_and_named(bag, caplog):
    folder, topics = bag
    kinds = STORE.types
    vector, quaternion = kinds["geometry_msgs/msg/Vector3"], kinds["geometry_msgs/msg/Quaternion"]
    place = kinds["geometry_msgs/msg/Transform"](vector(0.0, 0.0, 0.0), quaternion(0.0, 0.0, 0.0, 1.0))
    links = [("map", "base_link"), ("odom", "wheel")]
    frames = [
        kinds["geometry_msgs/msg/TransformStamped"](replace(header(0.0), frame_id=parent), child, place)
        for parent, child in links
    ]
    message = kinds["tf2_msgs/msg/TFMessage"](frames)
    with Writer(folder.parent / "tf", version=9) as writer:
        connection = writer.add_connection("/tf_static", "tf2_msgs/msg/TFMessage", typestore=STORE)
        writer.write(connection, 0, STORE.serialize_cdr(message, "tf2_msgs/msg/TFMessage"))
    assert broken_frames(folder) == ()  # without transforms nothing is said
    (problem,) = broken_frames(folder.parent / "tf")
    assert problem == "2 trees that nothing connects (map, odom): record the transform between them"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hil.datasets.rosbag.broken_frames", lambda path: broken_frames(folder.parent / "tf"))
        code, _ = hil("evaluate", folder, "--topics", topics)
    assert code == 0
    assert f"{folder}: {problem}" in caplog.text


@pytest.fixture
def mapping(topics):
    return read_topic_map(topics)


def test_a_bag_packed_as_a_whole_is_read_or_named(mapping, tmp_path):
    bag = tmp_path / "line_x_1"
    write_bag(bag)
    plain = read_bag(bag, mapping)
    file = next(bag.glob("*.mcap"))
    packed = file.with_name(f"{file.name}.zstd")
    packed.write_bytes(zstandard.compress(file.read_bytes()))
    assert len(read_bag(packed, mapping).t_s) == len(plain.t_s)
    metadata = bag / "metadata.yaml"
    text = metadata.read_text().replace(file.name, packed.name)
    text = re.sub("compression_format:.*", "compression_format: zstd", text)
    metadata.write_text(re.sub("compression_mode:.*", "compression_mode: FILE", text))
    file.unlink()
    np.testing.assert_array_equal(read_bag(bag, mapping).t_s, plain.t_s)
    packed.write_bytes(packed.read_bytes()[:-40])
    for given in (bag, packed):
        with pytest.raises(DataError, match="line_x_1"):
            read_bag(given, mapping)


def test_a_bag_packed_message_by_message_is_read(mapping, tmp_path):
    plain, bag = write_bag(tmp_path / "line_x_1", StoragePlugin.SQLITE3), tmp_path / "line_x_2"
    writer = Writer(bag, version=9)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with Reader(plain) as reader, writer:
        channels = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, rihs01=c.digest)
            for c in reader.connections
        }
        for connection, t_ns, data in reader.messages():
            writer.write(channels[connection.id], t_ns, data)
    np.testing.assert_array_equal(read_bag(bag, mapping).t_s, read_bag(plain, mapping).t_s)
