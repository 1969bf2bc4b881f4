#!/usr/bin/env bash
# Expected: DroneCAN uses frames of 29 bits only, so a node on a bus with other devices passes over frames of 11 bits;
#   PyPI's dronecan says so in its node, and its own SocketCAN driver tells both apart.
# Version: dronecan 1.0.27 with python-can 4.6.1
# So it is: its driver for python-can, which `make_node("can0")` takes wherever python-can is installed, calls every
#   frame extended. A sensor's frame 0x1A0 becomes an anonymous message of type 1. The same driver passes milliseconds
#   to `recv`, which takes seconds, so `receive(0.05)` waits 50 s on a quiet bus.
# Source: code, dronecan/driver/python_can.py, PythonCAN.receive; seen 2026-11-29 with CPython 3.11
# What to do: give `dronecan.node.Node` a driver of your own that drops frames of 11 bits and passes seconds.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet dronecan==1.0.27 python-can==4.6.1 setuptools==80.9.0
venv/bin/python -W ignore - <<'PY'
import can
from dronecan.driver.python_can import PythonCAN

driver = PythonCAN("bench", bustype="virtual", bitrate=500_000)
other = can.Bus(interface="virtual", channel="bench")
other.send(can.Message(arbitration_id=0x1A0, data=bytes(8), is_extended_id=False))
frame = driver.receive(0.001)
asked = []
driver._bus.recv = lambda timeout: asked.append(timeout)
driver.receive(0.05)
print(f"sent 0x1A0 with 11 bits, received 0x{frame.id:X}, extended: {frame.extended}")
print(f"receive(0.05) calls recv with a timeout of {asked[0]:g} s")
driver._writer_thread_should_stop = True
other.shutdown()
assert frame.extended and frame.id == 0x1A0
assert asked == [50.0]
PY
echo "still so"
