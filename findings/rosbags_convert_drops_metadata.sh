#!/usr/bin/env bash
# Expected: `rosbags-convert` from MCAP to MCAP, with no filter, keeps the file's metadata records and attachments: a
#   serial number, a calibration, what a recorder says about itself.
# Version: rosbags 0.11.9, mcap 1.6.0
# So it is: both are gone, without a word; the only metadata record of the result is rosbag2's own. (`mcap filter`
#   drops metadata as well unless asked with --include-metadata, and says so in its help.)
# Source: code, rosbags/convert; seen 2026-11-29 with CPython 3.11
# What to do: keep the original, or put what has to survive every conversion into a message.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet rosbags==0.11.9 mcap==1.6.0
venv/bin/python - <<'PY'
from mcap.writer import Writer

with open("one.mcap", "wb") as stream:
    writer = Writer(stream)
    writer.start(profile="ros2", library="example")
    writer.add_metadata("robot", {"serial": "0000"})
    writer.add_attachment(1, 1, "calibration.toml", "text/plain", b"scale = 1.0")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    writer.add_message(writer.register_channel("/a", "cdr", schema), 1, b"\0\1\0\0\2\0\0\0x\0", 1)
    writer.finish()
PY
venv/bin/rosbags-convert --src one.mcap --dst two --dst-storage mcap
venv/bin/python - <<'PY'
from mcap.reader import make_reader

def kept(path):
    with open(path, "rb") as stream:
        reader = make_reader(stream)
        names = [m.name for m in reader.iter_metadata()]
        return names, [a.name for a in reader.iter_attachments()], sum(1 for _ in reader.iter_messages())

print("before:", kept("one.mcap"))
print("after: ", kept("two/two.mcap"))
assert kept("one.mcap") == (["robot"], ["calibration.toml"], 1)
assert kept("two/two.mcap") == (["rosbag2"], [], 1)
PY
echo "still so"
