"""Our recordings before other people's readers, and a bag whose frames do not hang together.

`mcap`'s own reader checks the sums of chunks, data and summary; `mcap-ros2-support` decodes by the schemas in
the file, as Foxglove does; `rosbags` by its own types.
"""

import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex, Statistics
from mcap.stream_reader import StreamReader
from mcap_cases import driving_record

from hil.bench.blueprint import Blueprint
from hil.config.loading import load_bench
from hil.recording.frame_check import broken_frames, problems_of
from hil.recording.frames import describe_clock
from hil.recording.mcap_writer import McapRecorder
from hil.robot.kinematics import WheelGeometry
from hil.vocabulary.clock import NS_PER_S, WallOffset

CYCLES = 120


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("conformance") / "run.mcap"
    header = Blueprint(load_bench("emulated"), geometry=WheelGeometry.nominal()).header()
    clock = describe_clock(WallOffset(1_790_000_000 * NS_PER_S, 300, 5))
    recorder = McapRecorder(path, {**header, "clock": clock}, lossless=True)
    for k in range(CYCLES):
        recorder.write(driving_record(k))
    recorder.close()
    assert recorder.failure == ""
    return path


def test_mcaps_own_reader_finds_every_sum_index_and_count_right(recording):
    with recording.open("rb") as stream:
        records = list(StreamReader(stream, validate_crcs=True, emit_chunks=False).records)
    with recording.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        by_index = sum(1 for _ in reader.iter_messages())
    (statistics,) = (r for r in records if isinstance(r, Statistics))
    assert by_index == statistics.message_count == sum(type(r).__name__ == "Message" for r in records)
    assert len(summary.chunk_indexes) == statistics.chunk_count > 1
    assert all(isinstance(one, ChunkIndex) and one.message_index_offsets for one in summary.chunk_indexes)
    assert set(summary.channels) == set(statistics.channel_message_counts) | {
        k for k, c in summary.channels.items() if c.id not in statistics.channel_message_counts
    }
    assert all(c.schema_id in summary.schemas for c in summary.channels.values())


def test_every_message_is_decoded_by_the_schemas_in_the_file(recording):
    decoders = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support is not installed")
    seen = set()
    with recording.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[decoders.DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            seen.add(channel.topic)
            if channel.topic == "/joint_states":
                assert len(message.name) == len(message.position) == 8
    assert {"/tf", "/tf_static", "/clock", "/joint_states", "/odom", "/imu/data"} <= seen


def test_our_own_frames_hang_together(recording):
    assert broken_frames(recording) == ()


@pytest.mark.parametrize(
    ("parents", "used", "said"),
    [
        ({"body": {"wall"}, "imu": {"base"}}, {}, "2 trees that nothing connects (base, wall)"),
        ({"body": {"wall", "map"}}, {}, "frame body hangs on map and wall"),
        ({"a": {"b"}, "b": {"a"}}, {}, "frame a hangs on itself, in a loop"),
        ({"body": {"wall"}}, {"lidar": "/scan"}, "/scan is given in frame lidar, which no transform knows"),
    ],
)
def test_what_is_broken_about_frames_is_named_with_what_to_do(parents, used, said):
    problems = problems_of(parents, used)
    assert any(p.startswith(said) and ": " in p for p in problems), problems
    assert problems_of({"body": {"wall"}, "imu": {"body"}}, {"imu": "/imu/data"}) == []
