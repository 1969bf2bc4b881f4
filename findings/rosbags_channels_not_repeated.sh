#!/usr/bin/env bash
# Expected: an MCAP file whose summary repeats the schemas but not the channels is read: the format lets a writer
#   leave out either, and the channels stand in the data section, before their messages.
# Version: rosbags 0.11.9, mcap 1.6.0
# So it is: the file opens without a connection and gives no message, without an error. With neither schemas nor
#   channels in the summary the reader scans the file and finds all. mcap's own reader gives the messages each time.
# Source: https://mcap.dev/spec (summary section); code, rosbags/rosbag2/storage_mcap.py, McapReader._open;
#   seen 2026-11-29 with CPython 3.11
# What to do: write with `repeat_channels=True`, or scan files without connections by mcap's stream reader.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet rosbags==0.11.9 mcap==1.6.0
venv/bin/python - <<'PY'
from pathlib import Path

from mcap.stream_reader import StreamReader
from mcap.records import Message
from mcap.writer import Writer
from rosbags.rosbag2 import Reader

def write(path, channels, schemas):
    with path.open("wb") as stream:
        writer = Writer(stream, repeat_channels=channels, repeat_schemas=schemas)
        writer.start(profile="ros2", library="example")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/a", "cdr", schema)
        for k in range(3):
            writer.add_message(channel, k + 1, b"\0\1\0\0\2\0\0\0x\0", k + 1)
        writer.finish()
    return path

def found(path):
    with path.open("rb") as stream:
        own = sum(isinstance(r, Message) for r in StreamReader(stream).records)
    with Reader(path) as reader:
        return own, len(reader.connections), sum(1 for _ in reader.messages())

for channels, schemas, expected in ((1, 1, (3, 1, 3)), (0, 0, (3, 1, 3)), (0, 1, (3, 0, 0))):
    seen = found(write(Path(f"{channels}{schemas}.mcap"), bool(channels), bool(schemas)))
    print(f"channels {channels}, schemas {schemas}: mcap {seen[0]}; rosbags: connections {seen[1]}, messages {seen[2]}")
    assert seen == expected
PY
echo "still so"
