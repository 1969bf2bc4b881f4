#!/usr/bin/env bash
# Expected: a python-can bus whose connection is closed raises a `can.CanError` from `recv` and from `send`, the base of
#   all exceptions that python-can documents for them.
# Version: python-can-remote 0.3.0 with python-can 4.6.1
# So it is: `recv` raises WebsocketClosed, which is no CanError and no OSError; after it, `send` raises nothing and sends
#   nothing. A program that only sends, or that handles `can.CanError`, does not notice that its bus is gone.
# Source: code, can_remote/websocket.py, WebSocket.read and send_frame; seen 2026-11-29 with CPython 3.11
# What to do: count any exception of a bus as its failure, read also where nothing is expected, and open the bus again.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet python-can==4.6.1 python-can-remote==0.3.0
venv/bin/python - <<'PY'
import os
import threading
import time

import can
from can_remote.server import RemoteServer

server = RemoteServer("127.0.0.1", 0, interface="virtual", channel="far")
threading.Thread(target=server.serve_forever, daemon=True).start()
bus = can.Bus(interface="remote", channel=f"127.0.0.1:{server.server_port}", bitrate=500_000)
frame = can.Message(arbitration_id=1, data=b"x", is_extended_id=False)
bus.send(frame)
while not server.clients:
    time.sleep(0.05)
server.clients[0].close()
errors = []
for act in (lambda: bus.recv(5.0), lambda: bus.send(frame)):
    try:
        act()
        errors.append(None)
    except Exception as error:
        errors.append(error)
received, sent = errors
print(f"recv: {type(received).__name__}, a CanError: {isinstance(received, can.CanError)}; send: {sent}", flush=True)
assert type(received).__name__ == "WebsocketClosed" and not isinstance(received, (can.CanError, OSError))
assert sent is None
os._exit(0)  # closing the bus raises, too
PY
echo "still so"
