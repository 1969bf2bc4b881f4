#!/usr/bin/env bash
# Expected: with timeout 0 a read of 4096 bytes gives all that has come, as pyserial's local ports and `socket://` do; and
#   what had come before the server closed the connection can still be read.
# Version: pyserial 3.5
# So it is: on `rfc2217://` such a read gives one byte, however many wait. Once the connection is closed, `in_waiting`
#   counts the bytes that wait (and one more), but `read` raises: they are lost. A driver that polls every millisecond
#   gets 1000 bytes a second of a sensor that sends 10,000, each with the arrival of its poll.
# Source: code, serial/rfc2217.py, Serial.read; seen 2026-11-29 with CPython 3.11
# What to do: read `in_waiting` bytes in one call, or set a short timeout that is not 0.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet pyserial==3.5
venv/bin/python -W ignore - <<'PY'
import socket
import threading
import time

import serial
from serial import rfc2217

class Answer:
    """What the port manager of pyserial writes to: the connection."""

    def __init__(self, connection):
        self.write = connection.sendall

def serve(server, ended):
    connection, _ = server.accept()
    manager = rfc2217.PortManager(serial.serial_for_url("loop://"), Answer(connection))
    connection.settimeout(0.05)
    while not ended.is_set():
        try:
            list(manager.filter(connection.recv(1024)))
        except TimeoutError:
            pass
    connection.sendall(b"a line of twenty one\n")
    time.sleep(1.0)
    connection.close()

ended = threading.Event()
with socket.create_server(("127.0.0.1", 0)) as server:
    thread = threading.Thread(target=serve, args=(server, ended))
    thread.start()
    port = serial.serial_for_url(f"rfc2217://127.0.0.1:{server.getsockname()[1]}", timeout=0)
    ended.set()
    time.sleep(0.5)
    waiting, one = port.in_waiting, port.read(4096)
    thread.join()
    time.sleep(0.5)
    after = port.in_waiting
    try:
        said = f"gives {len(port.read(4096))} bytes"
    except serial.SerialException as error:
        said = f"raises {str(error)!r}"
    port.close()
print(f"{waiting} bytes wait, read(4096) gives {len(one)}")
print(f"connection closed: in_waiting = {after}, read(4096) {said}")
assert (waiting, len(one), after) == (21, 1, 21) and "reader thread died" in said
PY
echo "still so"
