#!/usr/bin/env bash
# Expected: a rosbag2 folder whose metadata.yaml states another quality of service than its MCAP file (edited for a
#   playback, or written anew by a tool) gives its messages: the quality says how to play them, not what they are.
# Version: rosbags 0.11.9
# So it is: the folder opens, `msgcount` is right, and `messages()` gives none, without an error or a warning. The
#   reader joins topics of metadata.yaml and channels of the file by name, type and quality. The file alone gives all.
# Source: code, rosbags/rosbag2/reader.py, DirectoryReader.messages; seen 2026-11-29 with CPython 3.11
# What to do: read the storage files themselves, or compare the number of messages with `msgcount`.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet rosbags==0.11.9
venv/bin/python - <<'PY'
import re
from pathlib import Path

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
kind = "std_msgs/msg/String"
ever = QosTime(2147483647, 4294967295)
quality = Qos(
    QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, QosDurability.VOLATILE, ever, ever,
    QosLiveliness.AUTOMATIC, ever, False,
)
bag = Path("bag")
with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
    lane = writer.add_connection("/a", kind, typestore=store, offered_qos_profiles=[quality])
    for k in range(3):
        writer.write(lane, k + 1, store.serialize_cdr(store.types[kind](data=str(k)), kind))

def count(path):
    with Reader(path) as reader:
        return sum(c.msgcount for c in reader.connections), sum(1 for _ in reader.messages())

print("as written:", count(bag))
assert count(bag) == (3, 3)
metadata = bag / "metadata.yaml"
text = metadata.read_text()
changed = re.sub(r"reliability: reliable", "reliability: best_effort", text)
assert changed != text, text
metadata.write_text(changed)
print("another reliability in metadata.yaml (msgcount, messages):", count(bag))
print("the file alone:", count(bag / "bag.mcap"))
assert count(bag) == (3, 0)
assert count(bag / "bag.mcap") == (3, 3)
PY
echo "still so"
