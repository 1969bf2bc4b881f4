"""The MCAP file that is written here, held against the library's writer: the same bytes."""

import io

from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer

from hil.recording.mcap_chunks import ChunkedFile

TOPICS = {"/a": 1, "/b": 2, "/c": 2}
SCHEMAS = {"std_msgs/msg/String": "string data", "std_msgs/msg/Bool": "bool data"}
ABOUT = {"offered_qos_profiles": "- history: 1"}
OFFSET_NS = 1_700_000_000 * 10**9

MESSAGES = st.lists(st.tuples(st.sampled_from(sorted(TOPICS)), st.integers(-(2**62), 2**61), st.binary()))
STEPS = st.lists(st.tuples(st.integers(0, 10**9), MESSAGES, st.sampled_from(["", "flush", "metadata"])))


def by_library(steps) -> bytes:
    output, sent = io.BytesIO(), dict.fromkeys(TOPICS, 0)
    indexes = IndexType.CHUNK | IndexType.MESSAGE | IndexType.METADATA
    writer = Writer(output, compression=CompressionType.ZSTD, chunk_size=1 << 30, index_types=indexes)
    writer.start(profile="ros2", library="test")
    schemas = [writer.register_schema(name, "ros2msg", text.encode()) for name, text in SCHEMAS.items()]
    channels = {t: writer.register_channel(t, "cdr", schemas[k - 1], ABOUT) for t, k in TOPICS.items()}
    log_ns = OFFSET_NS
    for later_ns, messages, then in steps:
        log_ns += later_ns
        for topic, t_ns, data in messages:
            published_ns = max(0, min(t_ns + OFFSET_NS, log_ns))
            writer.add_message(channels[topic], log_ns, data, published_ns, sent[topic])
            sent[topic] += 1
        if then == "flush":
            writer.flush()
        elif then == "metadata":
            writer.add_metadata("noted", {"at": str(log_ns)})
    writer.finish()
    return output.getvalue()


@given(steps=STEPS)
def test_it_writes_the_librarys_bytes(steps):
    output = io.BytesIO()
    file = ChunkedFile(output, "test", OFFSET_NS)
    schemas = [file.add_schema(name, text) for name, text in SCHEMAS.items()]
    for topic, number in TOPICS.items():
        file.add_topic(topic, schemas[number - 1], ABOUT)
    log_ns = OFFSET_NS
    for later_ns, messages, then in steps:
        log_ns += later_ns
        file.add(log_ns, messages)
        if then == "flush":
            file.flush()
        elif then == "metadata":
            file.add_metadata("noted", {"at": str(log_ns)})
    file.finish()
    assert output.getvalue() == by_library(steps)
