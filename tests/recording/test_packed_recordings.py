"""Bags that are packed as a whole or message by message are read as plain ones; damaged ones are named."""

import re

import numpy as np
import pytest
import zstandard
from mcap_cases import MAPPING
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from test_mcap_topics import write_bag

from hil.core.errors import DataError
from hil.datasets.rosbag import read_bag
from hil.datasets.topic_map import read_topic_map


@pytest.fixture
def mapping(tmp_path):
    path = tmp_path / "topics.toml"
    path.write_text(MAPPING)
    return read_topic_map(path)


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
