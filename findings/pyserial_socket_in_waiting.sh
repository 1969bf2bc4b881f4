#!/usr/bin/env bash
# Expected: pyserial's `in_waiting` is the number of bytes that wait, so `port.read(port.in_waiting)` gives them all;
#   it does for a local port and for `rfc2217://`.
# Version: pyserial 3.5
# So it is: on `socket://` it is 0 or 1, whether something waits. A loop that reads `in_waiting` bytes a cycle takes one
#   byte a cycle: at 100 Hz a sensor of 2 kB/s falls behind by 19 s every 20 s, and its samples look fresh.
# Source: code, serial/urlhandler/protocol_socket.py, Serial.in_waiting; seen 2026-11-29 with CPython 3.11
# What to do: read with timeout 0 and a large size, which gives all that has come, or ask the socket by FIONREAD.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet pyserial==3.5
venv/bin/python - <<'PY'
import socket
import time

import serial

with socket.create_server(("127.0.0.1", 0)) as server:
    port = serial.serial_for_url(f"socket://127.0.0.1:{server.getsockname()[1]}", timeout=0)
    far, _ = server.accept()
    far.sendall(bytes(500))
    time.sleep(0.5)
    waiting = port.in_waiting
    first, rest = port.read(waiting), port.read(4096)
    port.close()
    far.close()
print(f"500 bytes wait: in_waiting = {waiting}, read(in_waiting) gives {len(first)}, then read(4096) {len(rest)}")
assert (waiting, len(first), len(rest)) == (1, 1, 499)
PY
echo "still so"
