"""The chunks that we write ourselves, record by record beside those of the library's own writer."""

from __future__ import annotations

import io
import random
import struct

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from hil.recording.chunks import ChunkedFile

SCHEMAS = [("std_msgs/msg/String", b"string data"), ("rosgraph_msgs/msg/Clock", b"")]
TOPICS = [
    ("/one", 1, {"offered_qos_profiles": "- history: 1"}),
    ("/two", 2, {}),
    ("/never", 2, {}),
    ("/é", 1, {}),
]


class Theirs:
    """The library's writer, called as ours is."""

    def __init__(self, stream):
        self._writer = Writer(stream, compression=CompressionType.ZSTD, chunk_size=1 << 30)
        self._writer.start(profile="ros2", library="hil")
        self._sent = {}
        self.add_metadata, self.flush, self.finish = (
            self._writer.add_metadata, self._writer.flush, self._writer.finish,
        )  # fmt: skip

    def add_schema(self, name, encoding, data):
        return self._writer.register_schema(name, encoding, data)

    def add_topic(self, name, encoding, schema, metadata):
        return self._writer.register_channel(name, encoding, schema, metadata)

    def add(self, channel, log_ns, publish_ns, data):
        self._sent[channel] = self._sent.get(channel, -1) + 1
        self._writer.add_message(channel, log_ns, data, publish_ns, self._sent[channel])


def written(file_of, messages, every):
    """A file of messages (topic, log time, publish time, data), flushed after so many of them each time."""
    stream = io.BytesIO()
    file = file_of(stream)
    file.add_metadata("hil", {"header": '{"seed": 1}', "layout": "é"})
    for name, data in SCHEMAS:
        file.add_schema(name, "ros2msg", data)
    topics = [file.add_topic(name, "cdr", schema, metadata) for name, schema, metadata in TOPICS]
    for k, (topic, log_ns, publish_ns, data) in enumerate(messages, start=1):
        file.add(topics[topic], log_ns, publish_ns, data)
        if k % every == 0:
            file.flush()
    file.add_metadata("end", {})
    file.finish()
    return stream.getvalue()


def ours(stream):
    return ChunkedFile(stream, profile="ros2", library="hil")


def some_messages(seed):
    """Messages of three of the four topics, of any length, their times in any order."""
    rng = random.Random(seed)
    return [
        (
            rng.choice((0, 1, 3)),
            rng.randrange(1 << 62),
            rng.randrange(1 << 62),
            rng.randbytes(rng.randrange(300)),
        )
        for _ in range(rng.randrange(200))
    ]


def records_of(data):
    """All records but the footer and, in the summary, the place of a group that has no records."""
    found = list(StreamReader(io.BytesIO(data), validate_crcs=True).records)
    return [r for r in found[:-1] if getattr(r, "group_opcode", None) != Opcode.ATTACHMENT_INDEX]


@pytest.mark.parametrize("seed", range(12))
def test_every_record_is_that_of_the_library(seed):
    messages, every = some_messages(seed), 1 + 17 * (seed % 4)
    assert records_of(written(ours, messages, every)) == records_of(written(Theirs, messages, every))


def test_a_reader_finds_every_message_by_the_index():
    messages = some_messages(3)
    reader = make_reader(io.BytesIO(written(ours, messages, 20)), validate_crcs=True)
    by_time = [(c.topic, m.log_time, m.publish_time, m.data) for _, c, m in reader.iter_messages()]
    assert by_time == sorted(by_time, key=lambda one: one[1])
    assert sorted(by_time) == sorted((TOPICS[t][0], log, publish, data) for t, log, publish, data in messages)


def test_nothing_is_written_for_a_chunk_without_messages():
    stream = io.BytesIO()
    file = ours(stream)
    file.add_topic("/one", "cdr", file.add_schema("a", "ros2msg", b""), {})
    before = stream.tell()
    file.flush()
    assert stream.tell() == before


def test_a_message_that_is_refused_leaves_the_chunk_whole():
    stream = io.BytesIO()
    file = ours(stream)
    topic = file.add_topic("/one", "cdr", file.add_schema("a", "ros2msg", b""), {})
    file.add(topic, 1, 1, b"before")
    with pytest.raises(struct.error):
        file.add(topic, -1, 1, b"from before time")
    file.add(topic, 2, 2, b"after")
    file.finish()
    reader = make_reader(io.BytesIO(stream.getvalue()), validate_crcs=True)
    assert [(m.sequence, m.data) for _, _, m in reader.iter_messages()] == [(0, b"before"), (1, b"after")]
