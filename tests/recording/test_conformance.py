"""Our recordings before other people's readers, and a bag whose frames do not hang together.

`mcap`'s own reader checks the sums of chunks, data and summary; `mcap-ros2-support` decodes by the schemas in
the file, as Foxglove does; `rosbags` by its own types.
"""

import dataclasses

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex, Statistics, SummaryOffset
from mcap.stream_reader import StreamReader
from mcap_cases import driving_record
from recorded import HEADER, messages, recorded

from hil.core.clock import NS_PER_S, WallOffset
from hil.core.registry import kinds
from hil.core.signals import KINDS, AdhesionSample, LoadCellSample, Status, ThrustSample
from hil.datasets.frame_tree import broken_frames, problems_of
from hil.recording.topics import topics_with
from hil.recording.transform_tree import describe_clock

CYCLES = 120


def with_forces(record):
    """Fan, propellers and load cells beside the devices of every cycle; the fan has not said all yet."""
    (imu,), nan = record.inputs.imu, float("nan")
    inputs = dataclasses.replace(
        record.inputs,
        adhesion=(AdhesionSample(imu.stamp, 21000.0, 0.7, nan, 11.0, 14.8, 40.0, nan),),
        thrust=(ThrustSample(imu.stamp, 0.25, nan),),
        load_cells=(LoadCellSample(imu.stamp, np.array([51.0, nan]), (Status.OK, Status.CRC), (1, 2)),),
    )
    return dataclasses.replace(record, inputs=inputs)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("conformance") / "run.mcap"
    clock = describe_clock(WallOffset(1_790_000_000 * NS_PER_S, 300, 5))
    records = (with_forces(driving_record(k)) for k in range(CYCLES))
    return recorded(path, records, {**HEADER, "clock": clock}, note=(5, "mark", {"why": "a note"}))


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
    offsets = [r for r in records if isinstance(r, SummaryOffset)]
    assert all(one.group_length > 0 for one in offsets)  # an empty group is an error to `pymcap-cli doctor`
    assert all(c.schema_id in summary.schemas for c in summary.channels.values())


def values_of(message):
    """All that a message of either library holds, by the names of its fields."""
    names = getattr(message, "__slots__", None) or [f.name for f in dataclasses.fields(message)]
    return {
        name.lstrip("_"): of_value(getattr(message, name))
        for name in names
        if name[:2] != "__" and not name.isupper()
    }


def of_value(value):
    if isinstance(value, (list, tuple, np.ndarray, bytes)):
        return [of_value(item) for item in value]
    if isinstance(value, (str, int, float, np.generic)):
        return repr(float(value)) if isinstance(value, (float, np.floating)) else str(value)
    return values_of(value)


def test_two_libraries_read_every_topic_alike(recording):
    """mcap-ros2-support by the schemas in the file, rosbags by its own types."""
    decoders = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support is not installed")
    theirs, ours = {}, {}
    with recording.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[decoders.DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            theirs.setdefault(channel.topic, []).append(values_of(message))
    for topic, _, message in messages(recording):
        ours.setdefault(topic, []).append(values_of(message))
    shipped = tuple(kind for name, kind in kinds().items() if name in KINDS)
    assert set(ours) == set(theirs) == set(topics_with(shipped))
    for topic, found in ours.items():
        assert found == theirs[topic], topic
    assert len(ours["/hil/cycle"]) == len(ours["/joint_states"]) == CYCLES
    assert len(ours["/tracker/pose"]) == 2 * CYCLES
    assert len(ours["/joint_states"][7]["position"]) == 8


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
