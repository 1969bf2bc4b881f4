"""Recordings that unpack to far more than is stored: named, and neither memory nor time is spent on them."""

import gzip
import re
import struct
import tracemalloc
import zlib
from contextlib import contextmanager
from types import SimpleNamespace

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Chunk, ChunkIndex
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_cases import MAPPING, driving_record
from test_mcap_topics import write_bag

from hil.cli import main
from hil.recording import unpacking
from hil.recording.mcap_reader import RecordingReader
from hil.recording.mcap_records import top_level
from hil.recording.mcap_writer import McapRecorder
from hil.recording.rosbag import read_bag
from hil.recording.sources import find_recordings
from hil.recording.topic_map import read_topic_map
from hil.recording.unpacking import Allowance, chunk_data
from hil.vocabulary.errors import DataError

MIB = 1 << 20
MOST_MEMORY_BYTES = 200 * MIB


def zeros(size, compression):
    """That many zero bytes, packed."""
    if compression == "lz4":
        return lz4.frame.compress(bytes(size))
    packer = zstandard.ZstdCompressor().compressobj()
    pieces = [packer.compress(bytes(min(MIB, size - at))) for at in range(0, size, MIB)]
    return b"".join([*pieces, packer.flush()])


def packed(record):
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def chunk(data, compression, said):
    return packed(Chunk(compression, data, 0, 0, 0, said))


@pytest.fixture
def recording(tmp_path):
    """A recording of ours, and how to put bytes before its first chunk."""
    path = tmp_path / "line_x_1.mcap"
    recorder = McapRecorder(path, {"config": {}}, lossless=True)
    for k in range(5):
        recorder.write(driving_record(k))
    recorder.close()

    def insert(data):
        with path.open("rb") as stream:
            at = next(at for at, record in top_level(stream, 1 << 30) if isinstance(record, Chunk))
        whole = path.read_bytes()
        path.write_bytes(whole[:at] + data + whole[at:])
        return path

    return insert


@contextmanager
def little_memory():
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY_BYTES
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("command", ["replay", "evaluate", "export"])
def test_a_recording_that_unpacks_to_gigabytes_ends_in_a_message(recording, capsys, command, tmp_path):
    bomb = chunk(zeros(200 * MIB, "zstd"), "zstd", 200 * MIB)
    path = recording(5 * bomb)
    assert path.stat().st_size < MIB
    options = {
        "replay": ["--bench", "emulated"],
        "export": ["--out", str(tmp_path / "t.csv")],
        "evaluate": [],
    }
    assert main([command, str(path), *options[command]]) == 2
    said = capsys.readouterr().err
    assert "line_x_1.mcap" in said
    assert "unpacks to more than 64 MiB" in said


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize(
    ("said", "reason"), [(1000, "not 1000 bytes long"), (1 << 40, "more than 256"), (60 * MIB, "bytes long")]
)
def test_a_chunk_that_lies_about_its_size_is_named_and_the_rest_read(recording, compression, said, reason):
    path = recording(chunk(zeros(120 * MIB, compression), compression, said))
    with little_memory():
        reader = RecordingReader(path)
        assert len(list(reader)) == 5
    assert len(reader.problems) == 1
    assert reason in reader.problems[0]


@pytest.mark.parametrize(
    ("compression", "pack"), [("zstd", zstandard.compress), ("lz4", lz4.frame.compress), ("", bytes)]
)
def test_what_follows_the_packed_data_is_no_part_of_a_chunk(tmp_path, compression, pack):
    data = bytes(range(256)) * 5000
    allowance = Allowance(tmp_path, 1)
    whole = SimpleNamespace(
        uncompressed_size=len(data), uncompressed_crc=0, compression=compression, data=pack(data)
    )
    assert chunk_data(whole, allowance) == data
    whole.data += pack(b"more")
    with pytest.raises(ValueError, match="not 1280000 bytes long"):
        chunk_data(whole, allowance)


@pytest.mark.parametrize("name", ["line_x_1.csv.gz", "odom_1.csv.gz"])
def test_a_table_that_unpacks_to_gigabytes_is_named(tmp_path, name):
    packer = zlib.compressobj(wbits=31)
    pieces = [packer.compress(bytes(MIB)) for _ in range(300)]
    (tmp_path / name).write_bytes(b"".join([*pieces, packer.flush()]))
    (tmp_path / "abs_1.csv").write_text("time\n")
    with little_memory(), pytest.raises(DataError, match="unpacks to more than") as caught:
        find_recordings([tmp_path / name])[0].read()
    assert name in str(caught.value)


def test_a_table_may_unpack_to_much_more_than_is_stored(tmp_path, monkeypatch):
    path = tmp_path / "x.csv.gz"
    path.write_bytes(gzip.compress(b"1,2\n" * 100_000))
    assert len(unpacking.read_packed(path)) == 400_000
    monkeypatch.setattr(unpacking, "FREE_BYTES", 1000)
    with pytest.raises(DataError, match="unpacks to more than"):
        unpacking.read_packed(path)


@pytest.fixture
def mapping(tmp_path):
    path = tmp_path / "topics.toml"
    path.write_text(MAPPING)
    return read_topic_map(path)


def other_bag(folder, compression=CompressionType.ZSTD, size=100 * MIB, **options):
    """A bag of one message of zeros, written by the official library."""
    path = folder / "bomb.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, compression=compression, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/vicon", "cdr", schema)
        writer.add_message(channel, 1, bytes(size), 1)
        writer.finish()
    return path


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_bag_that_unpacks_to_gigabytes_is_named(tmp_path, mapping, monkeypatch, compression):
    path = other_bag(tmp_path, compression, 20 * MIB)
    monkeypatch.setattr(unpacking, "FREE_BYTES", 10 * MIB)
    monkeypatch.setattr(unpacking, "FACTOR", 10)
    with little_memory(), pytest.raises(DataError, match=r"bomb\.mcap: unpacks to more than 10 MiB"):
        read_bag(path, mapping)


def test_an_index_names_the_chunks_that_were_looked_at(tmp_path, mapping):
    path = other_bag(tmp_path, size=100)
    with path.open("rb") as stream:
        records = list(top_level(stream, MIB))
    index = next(record for _, record in records if isinstance(record, ChunkIndex))
    begin = next(at for at, record in records if isinstance(record, Chunk))
    data = path.read_bytes()
    hidden = packed(Attachment(0, 0, "x", "y", data[begin : begin + index.chunk_length]))
    elsewhere = struct.pack("<QQ", begin + len(hidden) - index.chunk_length - 4, index.chunk_length)
    there = struct.pack("<QQ", begin + len(hidden), index.chunk_length)
    moved = (
        data[:begin] + hidden + data[begin:].replace(struct.pack("<QQ", begin, index.chunk_length), elsewhere)
    )
    summary = struct.pack("<Q", records[-1][1].summary_start)
    moved = moved.replace(summary, struct.pack("<Q", records[-1][1].summary_start + len(hidden)))
    path.write_bytes(moved)
    with pytest.raises(DataError, match="its index names a chunk"):
        read_bag(path, mapping)
    path.write_bytes(moved.replace(elsewhere, there))
    with pytest.raises(DataError, match="has no topic /wheels"):
        read_bag(path, mapping)


def test_a_bag_packed_as_a_whole_is_read_within_bounds(mapping, tmp_path):
    bag = tmp_path / "line_x_1"
    write_bag(bag)
    plain = read_bag(bag, mapping)
    file = next(bag.glob("*.mcap"))
    file.with_name(f"{file.name}.zstd").write_bytes(zstandard.compress(file.read_bytes()))
    metadata = bag / "metadata.yaml"
    text = metadata.read_text().replace(file.name, f"{file.name}.zstd")
    text = re.sub("compression_format:.*", "compression_format: zstd", text)
    metadata.write_text(re.sub("compression_mode:.*", "compression_mode: FILE", text))
    file.unlink()
    assert len(read_bag(bag, mapping).t_s) == len(plain.t_s)
    file.with_name(f"{file.name}.zstd").write_bytes(zeros(300 * MIB, "zstd"))
    with little_memory(), pytest.raises(DataError, match="unpacks to more than 64 MiB"):
        read_bag(bag, mapping)
    metadata.write_text(re.sub("compression_mode:.*", "compression_mode: MESSAGE", text))
    file.with_name(f"{file.name}.zstd").write_bytes(b"")
    with pytest.raises(DataError):
        read_bag(bag, mapping)
