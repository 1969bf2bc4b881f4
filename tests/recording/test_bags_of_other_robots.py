"""Bags of other robots as they come: stamps, joints, kinds of file and names that another recorder chose."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import perfect_robot as perfect
import pytest
from mcap.writer import Writer as McapWriter
from mcap_cases import MAPPING
from perfect_robot import BEGIN_NS, DRIVE, JOINT, POSE, STEER, STORE, header_at

from hil.cli import main
from hil.core.errors import ConfigError, DataError
from hil.datasets.read import read_recordings
from hil.datasets.recording_names import motion_of
from hil.datasets.rosbag import read_bag
from hil.datasets.topic_map import read_topic_map
from hil.robot.kinematics import NOMINAL_RADIUS_M

RATE_HZ, SPEED_M_S, SECONDS = 50, 0.08, 10


def joints(t_ns, names, angles):
    return STORE.types[JOINT](header_at(t_ns), names, np.array(angles), np.array([]), np.array([]))


def pose(t_ns, x_m):
    return replace(perfect.pose(0.0, (x_m, 0.0, 0.0)), header=header_at(t_ns))


def messages(stamp=lambda log_ns, number: log_ns, *, apart=False, steer_every=1, speed_m_s=SPEED_M_S):
    """Of a drive straight ahead between rests: topic, log time (ns) and message, in order.

    Args:
        stamp: of the header, by the log time and the number of the sample, ns.
        apart: drive and steering in messages of their own, a tenth of a millisecond apart.
        steer_every: so many drive messages to one of the steering.
        speed_m_s: of the robot.
    """
    for k in range(SECONDS * RATE_HZ):
        log_ns, at = BEGIN_NS + k * 10**9 // RATE_HZ, k / RATE_HZ
        x_m = speed_m_s * min(max(0.0, at - 1.0), SECONDS - 2.0)
        angles = (x_m / NOMINAL_RADIUS_M * np.array([1.0, 1.0, -1.0, -1.0])).tolist()
        steering = [0.001 * at] * 4
        t_ns = stamp(log_ns, k)
        if apart:
            yield "/wheels", log_ns, joints(t_ns, DRIVE, angles)
            if k % steer_every == 0:
                yield "/wheels", log_ns + 100_000, joints(t_ns + 100_000, STEER, steering)
        else:
            yield "/wheels", log_ns, joints(t_ns, [*STEER, *DRIVE], [*steering, *angles])
        yield "/vicon", log_ns, pose(t_ns, x_m)


def write(folder, found):
    return perfect.write_bag(
        folder, ((topic, (ns - BEGIN_NS) / 1e9, message) for topic, ns, message in found)
    )


def read(folder, topics):
    return read_bag(folder, read_topic_map(topics))


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    folder = tmp_path_factory.mktemp("usual")
    (folder / "topics.toml").write_text(MAPPING)
    return read(write(folder / "usual_1", messages()), folder / "topics.toml")


@pytest.mark.parametrize("begin_ns", [0, -5_000_000_000])
def test_a_clock_that_passes_zero_has_a_stamp_there(tmp_path, topics, usual, begin_ns):
    """A simulation that begins at 0 had been refused: its first stamp was taken for none."""
    bag = write(tmp_path / "line_x_1", messages(lambda log_ns, k: log_ns - BEGIN_NS + begin_ns))
    found = read(bag, topics)
    np.testing.assert_array_equal(found.t_s, usual.t_s)
    np.testing.assert_array_equal(found.truth_t_s, usual.truth_t_s)


def test_headers_without_any_stamp_fall_back_to_the_times_of_the_log(tmp_path, topics, usual):
    found = read(write(tmp_path / "line_x_1", messages(lambda log_ns, k: 0)), topics)
    np.testing.assert_array_equal(found.t_s, usual.t_s)


@pytest.mark.parametrize("damaged_ns", [2_000_000_000_000_000_000, 0])
def test_a_damaged_stamp_is_named_with_its_message(tmp_path, topics, damaged_ns):
    bag = write(tmp_path / "line_x_1", messages(lambda log_ns, k: damaged_ns if k == 100 else log_ns))
    with pytest.raises(
        DataError,
        match=r"line_x_1: /wheels: message 101 of 500, recorded 2\.00 s after the first, is stamped "
        rf"{damaged_ns // 10**9}\.000 s, .* take it out, or cut the bag",
    ):
        read(bag, topics)


@pytest.mark.parametrize("every", [1, 4])
def test_drive_and_steering_may_come_in_messages_of_their_own(tmp_path, topics, usual, every):
    found = read(write(tmp_path / "line_x_1", messages(apart=True, steer_every=every)), topics)
    np.testing.assert_array_equal(found.wheel_angle_rad, usual.wheel_angle_rad)
    np.testing.assert_array_equal(found.t_s, usual.t_s)
    np.testing.assert_allclose(found.steering_rad, usual.steering_rad, atol=1e-4)
    assert not found.repairs


def test_drive_joints_may_come_one_by_one_and_wrap(tmp_path, topics, usual):
    """Between two messages around a wrap there is no angle: those rows are left out."""

    def one_by_one():
        for topic, log_ns, message in messages():
            if topic == "/vicon":
                yield topic, log_ns, message
                continue
            for k, name in enumerate(DRIVE):
                t_ns = log_ns + k * 1_000_000
                angle = math.remainder(message.position[4 + k], 2.0 * math.pi)
                yield topic, t_ns, joints(t_ns, [name], [angle])
            yield topic, log_ns, joints(log_ns, STEER, message.position[:4])

    found = read(write(tmp_path / "line_x_1", one_by_one()), topics)
    kept = np.isin(usual.t_s, found.t_s)
    assert 0 < np.count_nonzero(~kept) < 30
    assert found.repairs["wheel rows without numbers dropped"] == np.count_nonzero(~kept)
    np.testing.assert_allclose(found.wheel_angle_rad, usual.wheel_angle_rad[kept], atol=0.02)


def test_steering_that_was_not_sent_for_long_is_no_steering(tmp_path, topics):
    found = [
        one
        for one in messages(apart=True)
        if one[0] != "/wheels" or list(one[2].name) != STEER or not 4e9 < one[1] - BEGIN_NS < 6e9
    ]
    repairs = read(write(tmp_path / "line_x_1", found), topics).repairs
    assert repairs["wheel rows without numbers dropped"] == pytest.approx(100, abs=2)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"w2"', '"w1"', r"wheels: drive names the joint 'w1' twice"),
        ('"s1"', '"w3"', r"wheels: drive and steer both name the joint 'w3': "),
        ('"/vicon"', '"/wheels"', r"wheels\.topic and truth\.topic are both '/wheels'"),
    ],
)
def test_a_mapping_that_names_one_thing_twice_is_refused(topics, old, new, said):
    topics.write_text(MAPPING.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        read_topic_map(topics)
    assert len(caught.value.problems) == 1
    assert caught.match(said) or pytest.fail(str(caught.value))


@pytest.mark.parametrize("zeros", ["[0, 45, 0, 0]", "[0.0, 0.0, 0.0, nan]"])
def test_a_steering_zero_that_is_no_angle_in_radians_is_refused_by_its_name(tmp_path, topics, zeros, capsys):
    """The steering would be beyond its limits, and the bag be blamed for it."""
    topics.write_text(MAPPING.replace("[truth]", f"steer_zero_rad = {zeros}\n[truth]"))
    bag = write(tmp_path / "line_x_1", messages())
    assert main(["evaluate", str(bag), "--topics", str(topics)]) == 2
    said = capsys.readouterr().err
    assert all(word in said for word in (str(topics), "wheels.steer_zero_rad", "radians"))
    assert str(bag) not in said


def test_a_steering_zero_within_a_turn_is_one(topics):
    """As of a joint that counts from 0 to 2 pi."""
    topics.write_text(MAPPING.replace("[truth]", "steer_zero_rad = [0.0, 4.71, 0.0, -3.2]\n[truth]"))
    assert read_topic_map(topics).wheels.steer_zero_rad == (0.0, 4.71, 0.0, -3.2)


@pytest.mark.parametrize(
    ("name", "motion"), [("line_x", "line_x"), ("run_10", "run"), ("_3", "_3"), ("line_x_2b", "line_x_2b")]
)
def test_only_a_number_makes_a_repetition(name, motion):
    """`line_x` and `line_y` had been two repetitions of `line`, one held out of a fit to the other."""
    assert motion_of(name) == motion


def test_bags_named_after_their_motions_are_no_repetitions(tmp_path, topics):
    folder = tmp_path / "bags"
    folder.mkdir()
    for name, speed_m_s in (("line_x", 0.08), ("line_fast", 0.1), ("line_x_2", 0.09)):
        write(folder / name, messages(speed_m_s=speed_m_s))
    found = {one.name: one.motion for one in read_recordings([folder], topics=topics)}
    assert found == {"line_fast": "line_fast", "line_x": "line_x", "line_x_2": "line_x"}


def rows_of(table):
    with table.open(newline="") as file:
        return list(csv.DictReader(file))


def test_nothing_is_exported_where_nothing_was_commanded(tmp_path, topics, capsys):
    """Set-points of 0 had stood there."""
    bag, out = write(tmp_path / "line_x_1", messages()), tmp_path / "line_x_1.csv"
    assert main(["export", str(bag), "--topics", str(topics), "--out", str(out), "--json"]) == 0
    names = [name for name in json.loads(capsys.readouterr().out)["columns"] if name.startswith("setpoint")]
    assert len(names) == 8
    assert {row[name] for row in rows_of(out) for name in names} == {""}


def test_an_export_keeps_the_angles_behind_a_gap(tmp_path, topics, usual):
    found = [m for m in messages() if m[0] != "/wheels" or not 5e9 < m[1] - BEGIN_NS < 6.2e9]
    out = tmp_path / "line_x_1.csv"
    assert (
        main(["export", str(write(tmp_path / "bag", found)), "--topics", str(topics), "--out", str(out)]) == 0
    )
    last = rows_of(out)[-1]
    assert [float(last[f"phi{i}"]) for i in range(1, 5)] == usual.wheel_angle_rad[-1].tolist()


def mcap(path, *, profile="ros2", schema="ros2msg", encoding="cdr"):
    """A sound MCAP file with one message on each topic of the mapping."""
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile=profile, library="test")
        for topic, kind in (("/wheels", JOINT), ("/vicon", POSE)):
            definition = STORE.generate_msgdef(kind, ros_version=2)[0] if schema == "ros2msg" else "{}"
            number = writer.register_schema(name=kind, encoding=schema, data=definition.encode())
            channel = writer.register_channel(schema_id=number, topic=topic, message_encoding=encoding)
            writer.add_message(channel, log_time=1, publish_time=1, data=b"{}", sequence=0)
        writer.finish()


@pytest.mark.parametrize(
    ("made", "said"),
    [
        ({"encoding": "json"}, "encoded as 'json'"),
        ({"profile": "", "schema": "jsonschema", "encoding": "json"}, "/wheels is encoded as 'json'"),
        ({"profile": "ros1", "schema": "ros1msg", "encoding": "ros1"}, "/wheels is encoded as 'ros1'"),
    ],
)
def test_an_mcap_file_of_another_kind_is_to_be_converted(tmp_path, topics, made, said):
    """They were to be repaired with `mcap recover`, though nothing in them is broken."""
    mcap(tmp_path / "line_x_1.mcap", **made)
    with pytest.raises(DataError) as caught:
        read(tmp_path / "line_x_1.mcap", topics)
    assert said in str(caught.value)
    assert "convert it to a rosbag2 recording" in str(caught.value)
    assert "recover" not in str(caught.value)
