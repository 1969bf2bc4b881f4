#!/usr/bin/env bash
# Expected: ROS 2 messages that foxglove-sdk writes to MCAP (schema `ros2msg`, encoding `cdr`) are read by rosbags:
#   each channel says what it holds.
# Version: foxglove-sdk 0.30.3, rosbags 0.11.9
# So it is: rosbags refuses the file, "Profile is not ros2.": foxglove-sdk leaves the header's profile empty, and
#   rosbags asks for it. With the profile given to the writer the same file is read.
# Source: https://mcap.dev/spec (the profile is optional); code, rosbags/rosbag2/storage_mcap.py; seen 2026-11-29 with
#   CPython 3.11
# What to do: `foxglove.open_mcap(path, writer_options=MCAPWriteOptions(profile="ros2"))`.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet foxglove-sdk==0.30.3 rosbags==0.11.9
venv/bin/python - <<'PY'
from pathlib import Path

import foxglove
from foxglove import Channel, Schema
from foxglove.mcap import MCAPWriteOptions
from rosbags.rosbag2 import Reader, ReaderError

schema = Schema(name="std_msgs/msg/String", encoding="ros2msg", data=b"string data")
channel = Channel("/a", schema=schema, message_encoding="cdr")

def written(name, options):
    with foxglove.open_mcap(name, writer_options=options):
        channel.log(b"\0\1\0\0\2\0\0\0x\0", log_time=1)
    try:
        with Reader(Path(name)) as reader:
            return sum(1 for _ in reader.messages())
    except ReaderError as error:
        return str(error)

as_usual = written("usual.mcap", None)
with_profile = written("profile.mcap", MCAPWriteOptions(profile="ros2"))
print("as usual:", as_usual)
print("with the profile:", with_profile)
assert as_usual == "Profile is not ros2."
assert with_profile == 1
PY
echo "still so"
