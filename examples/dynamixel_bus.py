"""Stock ROBOTIS dynamixel_sdk: finds the servos, reads them together, turns the first for a second.

Usage: python dynamixel_bus.py endpoints.json
"""

from __future__ import annotations

import json
import math
import os
import sys
import time

from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, PacketHandler, PortHandler

TORQUE_ENABLE, GOAL_VELOCITY, PRESENT_POSITION = 64, 104, 132
RAD_PER_COUNT = 2.0 * math.pi / 4096
RAD_S_PER_COUNT = 0.229 * 2.0 * math.pi / 60.0
TURN_COUNTS, TURN_S = 44, 1.0
PATIENCE_S, READ_S = 60.0, 2.0


def signed(value: int) -> int:
    """A 32-bit register as the SDK returns it, with its sign."""
    return value - (1 << 32) if value & 0x80000000 else value


def positions(group: GroupSyncRead, ids: list[int]) -> dict[int, int]:
    """Present positions of all servos by one sync read, counts; a lost reply is asked for again."""
    end = time.monotonic() + READ_S
    while time.monotonic() < end:
        if group.txRxPacket() == COMM_SUCCESS:
            return {i: signed(group.getData(i, PRESENT_POSITION, 4)) for i in ids}
    raise SystemExit(f"no complete sync read in {READ_S:g} s")


def ask(call, *arguments):
    """An acknowledged request, up to three times: what it returned beside result and error."""
    for _ in range(3):
        *values, result, error = call(*arguments)
        if result == COMM_SUCCESS and error == 0:
            return values[0] if values else None
    raise SystemExit(f"{call.__name__}{arguments[1:]}: result {result}, error {error}")


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
    """Find, read, turn."""
    where = endpoints(sys.argv[1])["servos"]
    ids = where["ids"]
    port, packets = PortHandler(where["port"]), PacketHandler(2.0)
    if not (port.openPort() and port.setBaudRate(where["baud"])):
        raise SystemExit(f"{where['port']} cannot be opened at {where['baud']} baud")
    for i in ids:
        print(f"servo {i}: model {ask(packets.ping, port, i)}")
    group = GroupSyncRead(port, packets, PRESENT_POSITION, 4)
    for i in ids:
        group.addParam(i)
        ask(packets.write1ByteTxRx, port, i, TORQUE_ENABLE, 1)
    before = positions(group, ids)
    ask(packets.write4ByteTxRx, port, ids[0], GOAL_VELOCITY, TURN_COUNTS)
    began = time.monotonic()
    reads = 0
    while time.monotonic() < began + TURN_S:
        positions(group, ids)
        reads += 1
    ask(packets.write4ByteTxRx, port, ids[0], GOAL_VELOCITY, 0)
    turned = (positions(group, ids)[ids[0]] - before[ids[0]]) * RAD_PER_COUNT
    asked = TURN_COUNTS * RAD_S_PER_COUNT * TURN_S
    print(f"{reads} sync reads of {len(ids)} servos in {TURN_S:.0f} s")
    print(f"servo {ids[0]} turned {turned:.2f} rad, asked for {asked:.2f} rad")
    port.closePort()


if __name__ == "__main__":
    main()
