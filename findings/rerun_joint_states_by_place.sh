#!/usr/bin/env bash
# Expected: joints of `sensor_msgs/JointState` become series by their names: ROS lets a message list any joints in
#   any order, and publishers send drives and steering axes apart, or leave out a joint that did not answer.
# Version: rerun-sdk 0.41.0
# So it is: `rerun mcap convert` keeps one row of values for each message, by place, and the names beside it. Where the
#   joints of two messages differ, place 0 holds one joint and then another, in one and the same column.
# Source: seen 2026-11-29 with CPython 3.11
# What to do: record the same joints in the same order in every message, or select by the names column before plotting.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet rerun-sdk==0.41.0 rosbags==0.11.9 mcap==1.6.0
venv/bin/python - <<'PY'
import numpy as np
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

store, kind = get_typestore(Stores.ROS2_HUMBLE), "sensor_msgs/msg/JointState"
header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
with open("joints.mcap", "wb") as stream:
    writer = Writer(stream)
    writer.start(profile="ros2", library="example")
    schema = writer.register_schema(kind, "ros2msg", store.generate_msgdef(kind, ros_version=2)[0].encode())
    channel = writer.register_channel("/joint_states", "cdr", schema)
    for t_s, names, angles in ((1, ["a", "b", "c"], [1.0, 2.0, 3.0]), (2, ["b", "c"], [2.0, 3.0])):
        message = store.types[kind](header(time(t_s, 0), ""), names, np.array(angles), np.array([]), np.array([]))
        writer.add_message(channel, t_s * 10**9, bytes(store.serialize_cdr(message, kind)), t_s * 10**9)
    writer.finish()
PY
venv/bin/rerun mcap convert joints.mcap -o joints.rrd > said.txt 2>&1
venv/bin/rerun rrd print -vvv joints.rrd 2>&1 | tee printed.txt | grep -oE '\[[0-9]\.0(, [0-9]\.0)+\] *┆ \[[abc, ]+\]'
grep -qE '\[1\.0, 2\.0, 3\.0\] *┆ \[a, b, c\]' printed.txt
grep -qE '\[2\.0, 3\.0\] *┆ \[b, c\]' printed.txt
! grep -qE 'joint_states/position/[abc]|joint_states/[abc]' printed.txt
echo "still so"
