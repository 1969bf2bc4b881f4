"""Plain pyserial: identifies a BNO055, switches it to inertial fusion, reads gravity and orientation.

Usage: python bno055_uart.py endpoints.json
"""

from __future__ import annotations

import json
import math
import os
import struct
import sys
import time

import serial

CHIP_ID, QUATERNION, GRAVITY, OPERATING_MODE = 0x00, 0x20, 0x2E, 0x3D
CONFIGURE, INERTIAL = 0x00, 0x08
READ_ANSWER, STATUS, WRITTEN = 0xBB, 0xEE, 0x01
DURATION_S, PATIENCE_S = 2.0, 60.0


def read(port: serial.Serial, register: int, count: int) -> bytes:
    """Registers; the chip's busy answers are retried, as every driver of it must."""
    reply = b""
    for _ in range(20):
        port.reset_input_buffer()
        port.write(bytes((0xAA, 0x01, register, count)))
        reply = port.read(2)
        if len(reply) == 2 and reply[0] == READ_ANSWER and reply[1] == count:
            data = port.read(count)
            if len(data) == count:
                return data
    raise SystemExit(f"register 0x{register:02X} cannot be read: {reply.hex() or 'silence'}")


def write(port: serial.Serial, register: int, value: int) -> None:
    """One register, acknowledged."""
    reply = b""
    for _ in range(20):
        port.reset_input_buffer()
        port.write(bytes((0xAA, 0x00, register, 1, value)))
        reply = port.read(2)
        if reply == bytes((STATUS, WRITTEN)):
            return
    raise SystemExit(f"register 0x{register:02X} cannot be written: {reply.hex() or 'silence'}")


def endpoints(path: str) -> dict:
    """What `hil emulate` says of its devices; waits for the file, which appears when they answer."""
    end = time.monotonic() + PATIENCE_S
    while not (os.path.exists(path) and os.path.getsize(path)):
        if time.monotonic() > end:
            raise SystemExit(f"{path} has not appeared: is `hil emulate --out {path}` running?")
        time.sleep(0.1)
    with open(path, encoding="utf-8") as file:
        return json.load(file)


def main() -> None:
    """Identify, configure, read."""
    where = endpoints(sys.argv[1])["imu"]
    with serial.Serial(where["port"], where["baud"], timeout=0.1) as port:
        print(f"chip id 0x{read(port, CHIP_ID, 1)[0]:02X}")
        write(port, OPERATING_MODE, CONFIGURE)
        time.sleep(0.03)
        write(port, OPERATING_MODE, INERTIAL)
        time.sleep(0.3)
        began, gravity, reads = time.monotonic(), (0.0, 0.0, 0.0), 0
        while time.monotonic() < began + DURATION_S:
            data = read(port, QUATERNION, GRAVITY + 6 - QUATERNION)
            quaternion = [v / 16384.0 for v in struct.unpack_from("<4h", data)]
            gravity = tuple(v / 100.0 for v in struct.unpack_from("<3h", data, GRAVITY - QUATERNION))
            reads += 1
    norm = math.sqrt(sum(v * v for v in quaternion))
    print(f"{reads / DURATION_S:.0f} reads per second")
    print(f"quaternion of length {norm:.4f}, gravity {math.hypot(*gravity):.2f} m/s2 along {gravity}")


if __name__ == "__main__":
    main()
