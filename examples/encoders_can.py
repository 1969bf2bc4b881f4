"""python-can and cantools: listens to the four AS5045 steering encoders for two seconds.

Usage: python encoders_can.py endpoints.json
"""

from __future__ import annotations

import json
import os
import sys
import time

import can
import cantools

DURATION_S, PATIENCE_S = 2.0, 60.0
OCF, COF, LIN = 1 << 5, 1 << 4, 1 << 3


def degrees(word: int) -> float | None:
    """Angle of an 18-bit AS5045 word; None where its parity or its flags say that it is bad."""
    good = word.bit_count() % 2 == 0 and word & OCF and not word & (COF | LIN)
    return (word >> 6) * 360.0 / 4096 if good else None


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
    """Listen, decode, count."""
    where = endpoints(sys.argv[1])["can"]
    database = cantools.database.load_file(where["dbc"])
    angles: dict[str, float] = {}
    frames = bad = 0
    keys = {k: v for k, v in where.items() if k != "dbc"}
    with can.Bus(**keys) as bus:
        end = time.monotonic() + DURATION_S
        while (left := end - time.monotonic()) > 0:
            message = bus.recv(left)
            if message is None or message.is_error_frame:
                continue
            frames += 1
            signals = database.decode_message(message.arbitration_id, message.data)
            for name, word in signals.items():
                if name.startswith("Angle"):
                    found = degrees(int(word))
                    bad += found is None
                    angles[name] = angles.get(name, float("nan")) if found is None else found
    print(f"{frames / DURATION_S:.0f} frames per second, {bad} bad words")
    print(", ".join(f"{name} {value:.1f} deg" for name, value in sorted(angles.items())))
    if len(angles) != 4:
        raise SystemExit("not all four encoders were heard")


if __name__ == "__main__":
    main()
