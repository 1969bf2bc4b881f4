"""Recordings and bags as other programs leave them: sorted, regrouped, stripped of what the format lets go.

The files are written by `mcap`, the format's reference library, in the forms that pymcap-cli 0.34, `mcap` and
`ros2 bag` give them.
"""

import itertools
import re

import numpy as np
import perfect_robot as perfect
import pytest
from mcap.reader import make_reader
from mcap.writer import IndexType, Writer
from mcap_cases import driving_record
from recorded import HEADER

from hil.cli import main
from hil.core.clock import WallOffset
from hil.core.errors import DataError
from hil.datasets.rosbag import read_bag
from hil.recording.mcap_reader import Note, RecordingReader, read_cycles
from hil.recording.mcap_writer import McapRecorder
from hil.recording.record_comparison import first_difference
from hil.recording.transform_tree import describe_clock

CYCLES = 120
QUALITY = r"offered_qos_profiles:.*?(?=\n {6}\w|\n {4}message_count)"
FOREVER = "{sec: 9223372036, nsec: 854775807}"
OTHER_QUALITY = (
    f"{{history: keep_last, depth: 7, reliability: best_effort, durability: volatile, deadline: {FOREVER}, "
    f"lifespan: {FOREVER}, liveliness: automatic, liveliness_lease_duration: {FOREVER}, "
    "avoid_ros_namespace_conventions: false}"
)


def content(path):
    with path.open("rb") as stream:
        reader = make_reader(stream)
        return list(reader.iter_messages(log_time_order=False)), list(reader.iter_metadata())


def rewritten(path, anew, *, key=lambda found: 0, metadata="first", profile="ros2", **how):
    """The same messages, stably sorted by `key`, a chunk for each value of it.

    Args:
        path: file to read.
        anew: file to write.
        key: of a message with schema and channel.
        metadata: `first`, `last` or `none`.
        profile: of the file.
        how: arguments of the writer.
    """
    messages, kept = content(path)
    with anew.open("wb") as stream:
        writer = Writer(stream, **{"chunk_size": 1 << 30, **how})
        writer.start(profile=profile, library="another")
        ids = {}

        def add_metadata():
            for each in kept:
                writer.add_metadata(each.name, each.metadata)

        if metadata == "first":
            add_metadata()
        for _, group in itertools.groupby(sorted(messages, key=key), key=key):
            for schema, channel, message in group:
                if channel.id not in ids:
                    kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                    ids[channel.id] = writer.register_channel(
                        channel.topic, channel.message_encoding, kind, channel.metadata
                    )
                writer.add_message(
                    ids[channel.id], message.log_time, message.data, message.publish_time, message.sequence
                )
            writer.flush()
        if metadata == "last":
            add_metadata()
        writer.finish()
    return anew


def topic(found):
    return found[1].topic


def backwards_by_second(found):
    return -(found[2].log_time // 10**9)


FORMS = {
    "metadata record behind the messages": {"metadata": "last"},
    "a chunk for each topic": {"key": topic},
    "chunks backwards": {"key": backwards_by_second},
    "backwards without chunks": {"key": backwards_by_second, "use_chunking": False},
    "types, but no channels in the summary": {"repeat_channels": False},
    "channels, but no types in the summary": {"repeat_schemas": False},
    "no index of any kind": {
        "index_types": IndexType.NONE,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
    },
    "no index of messages": {"index_types": IndexType.CHUNK},
    "no profile": {"profile": ""},
}


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    """A recording of two runs, with notes at the very times of their cycles."""
    path = tmp_path_factory.mktemp("ours") / "run.mcap"
    recorder = McapRecorder(path, {**HEADER, "clock": describe_clock(WallOffset(7, 3, 5))}, lossless=True)
    for k in range(CYCLES):
        record = driving_record(k)
        if k in (0, 50):
            recorder.note(record.start_ns, "mark", {"before": k})
        recorder.write(record)
        if k == 49:
            recorder.note(record.start_ns, "mark", {"behind": k})
    recorder.close()
    assert recorder.failure == ""
    return path


def told(path):
    """What a recording holds, in order: numbers of cycles, data of notes."""
    return [item.data if isinstance(item, Note) else item.cycle for item in RecordingReader(path).items()]


@pytest.mark.parametrize("form", FORMS)
def test_our_recording_is_read_alike_in_every_form(tmp_path, ours, form):
    """A sorted file had been "damaged"; one regrouped by topics had repeated another run."""
    anew = rewritten(ours, tmp_path / "anew.mcap", **FORMS[form])
    assert told(anew) == told(ours)
    assert told(ours)[0] == {"before": 0}
    assert told(ours)[50:54] == [49, {"behind": 49}, {"before": 50}, 50]
    assert first_difference(tuple(read_cycles(ours)), tuple(read_cycles(anew))) is None


def test_log_times_keep_the_order_and_no_message_is_published_after_its_log_time(ours):
    messages, _ = content(ours)
    own = [m.log_time for _, channel, m in messages if channel.topic in ("/hil/cycle", "/hil/notes")]
    assert np.all(np.diff(own) > 0)
    assert all(message.publish_time <= message.log_time for _, _, message in messages)
    assert any(message.publish_time < message.log_time for _, _, message in messages)


def test_a_recording_that_lost_its_metadata_is_told_from_another_robots(tmp_path, ours, capsys):
    anew = rewritten(ours, tmp_path / "anew.mcap", metadata="none", repeat_channels=False)
    assert main(["replay", str(anew)]) == 2
    said = capsys.readouterr().err
    assert "has cycle records, but not the metadata record `hil`" in said
    assert "--include-metadata" in said
    assert "damaged" not in said
    foreign = rewritten(
        ours, tmp_path / "foreign.mcap", key=lambda found: 0, metadata="none", use_chunking=False
    )
    data = foreign.read_bytes().replace(b"/hil/cycle", b"/not/cycle")
    foreign.write_bytes(data)
    assert main(["replay", str(foreign)]) == 2
    assert "holds no cycle records of this project" in capsys.readouterr().err


def test_a_file_merged_with_itself_is_read_once(tmp_path, ours, caplog):
    messages, kept = content(ours)
    twice = tmp_path / "twice.mcap"
    with twice.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="another")
        for _ in range(2):
            for metadata in kept:
                writer.add_metadata(metadata.name, metadata.metadata)
            for schema, channel, message in messages:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                lane = writer.register_channel(channel.topic, channel.message_encoding, kind)
                writer.add_message(lane, message.log_time, message.data, message.publish_time)
        writer.finish()
    assert told(twice) == told(ours)
    assert first_difference(tuple(read_cycles(ours)), tuple(read_cycles(twice))) is None
    assert f"{CYCLES + 3} messages that stand twice" in caplog.text


def test_a_file_merged_from_two_recordings_is_refused(tmp_path, ours):
    """Their cycles had become runs of one another; the same metadata twice is one recording."""
    messages, (kept, *_) = content(ours)
    other = {**kept.metadata, "header": kept.metadata["header"].replace('"seed": ', '"seed": 1')}
    for name, second in (("twice.mcap", kept.metadata), ("merged.mcap", other)):
        with (tmp_path / name).open("wb") as stream:
            writer = Writer(stream)
            writer.start(profile="ros2", library="another")
            for metadata in (kept.metadata, second):
                writer.add_metadata(kept.name, metadata)
            number = writer.register_schema("x", "", b"")
            channel = writer.register_channel("/hil/cycle", "cdr", number)
            for _, found, message in messages:
                if found.topic == "/hil/cycle":
                    writer.add_message(channel, message.log_time, message.data, message.log_time)
            writer.finish()
    assert len(tuple(read_cycles(tmp_path / "twice.mcap"))) == CYCLES
    assert other != kept.metadata
    with pytest.raises(DataError, match=r"merged\.mcap: holds 2 recordings in one file"):
        tuple(read_cycles(tmp_path / "merged.mcap"))


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A rosbag2 folder of another robot, its mapping, and what is read of it."""
    return perfect.bag_as_read(tmp_path_factory.mktemp("bag"))


@pytest.mark.parametrize("form", FORMS)
def test_a_bag_is_read_alike_in_every_form(tmp_path, bag, form):
    """Most had "no topic", "expected one of" nothing, or "no message"."""
    made, mapping, expected = bag
    (file,) = made.glob("*.mcap")
    found = read_bag(rewritten(file, tmp_path / "curve_1.mcap", **FORMS[form]), mapping)
    np.testing.assert_array_equal(found.t_s, expected.t_s)
    np.testing.assert_array_equal(found.wheel_angle_rad, expected.wheel_angle_rad)
    np.testing.assert_array_equal(found.truth_pose, expected.truth_pose)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (QUALITY, f"offered_qos_profiles: [{OTHER_QUALITY}]"),
        (QUALITY, "offered_qos_profiles: [{reliability: x}]"),
        (r"\n  version: \d+", "\n  version: 99"),
        (r".*", "what is this"),
    ],
    ids=["another quality", "unknown quality", "a later version", "no metadata at all"],
)
def test_a_folder_is_read_by_its_files_not_by_what_is_said_of_them(tmp_path, bag, old, new):
    made, mapping, expected = bag
    folder = tmp_path / "curve_1"
    folder.mkdir()
    (file,) = made.glob("*.mcap")
    (folder / file.name).write_bytes(file.read_bytes())
    text = (made / "metadata.yaml").read_text()
    changed = re.sub(old, new, text, flags=re.DOTALL)
    assert changed != text
    (folder / "metadata.yaml").write_text(changed)
    np.testing.assert_array_equal(read_bag(folder, mapping).t_s, expected.t_s)


def test_a_folder_that_lacks_a_file_of_its_metadata_is_refused_by_its_name(tmp_path, bag):
    made, mapping, _ = bag
    folder = tmp_path / "curve_1"
    folder.mkdir()
    (file,) = made.glob("*.mcap")
    (folder / "first.mcap").write_bytes(file.read_bytes())
    text = (made / "metadata.yaml").read_text()
    named = re.sub(r"(\n *)- curve_1.mcap", r"\1- first.mcap\1- second.mcap", text, count=1)
    assert named != text
    (folder / "metadata.yaml").write_text(named)
    with pytest.raises(DataError, match=r"curve_1: lacks second\.mcap, which its metadata\.yaml names"):
        read_bag(folder, mapping)


def test_a_topic_that_no_one_can_decode_does_not_keep_others_from_being_read(tmp_path, bag):
    """One type without a definition, one whose definition is broken, among the wheels'."""
    made, mapping, expected = bag
    (file,) = made.glob("*.mcap")
    messages, _ = content(file)
    anew = tmp_path / "curve_1.mcap"
    with anew.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="another")
        for name, definition in (("a/msg/B", b"float64 ???"), ("c/msg/D", b"")):
            number = writer.register_schema(name, "ros2msg", definition)
            channel = writer.register_channel(f"/{name}", "cdr", number)
            writer.add_message(channel, perfect.BEGIN_NS, b"\0\1\0\0", perfect.BEGIN_NS)
        ids = {}
        for schema, channel, message in messages:
            if channel.id not in ids:
                data = b"" if channel.topic == "/wheels" else schema.data
                kind = writer.register_schema(schema.name, "" if not data else schema.encoding, data)
                ids[channel.id] = writer.register_channel(channel.topic, "cdr", kind)
            writer.add_message(ids[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    np.testing.assert_array_equal(read_bag(anew, mapping).t_s, expected.t_s)
