"""PyPI natnet: asks a motion-capture server for its rigid bodies and listens for two seconds.

Usage: python mocap_natnet.py endpoints.json
"""

from __future__ import annotations

import json
import os
import sys
import time

from natnet import DataDescriptions, DataFrame, NatNetClient

DURATION_S, PATIENCE_S = 2.0, 60.0


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
    """Connect, listen, count."""
    where = endpoints(sys.argv[1])["mocap"]
    frames: list[DataFrame] = []
    names: dict[int, str] = {}

    def described(found: DataDescriptions) -> None:
        names.update({body.id_num: body.name for body in found.rigid_bodies})

    client = NatNetClient(
        server_ip_address=where["server"],
        local_ip_address="127.0.0.1",
        multicast_address=where["multicast"] or "239.255.42.99",
        command_port=where["command_port"],
        data_port=where["data_port"],
        use_multicast=where["multicast"] is not None,
    )
    client.on_data_frame_received_event.handlers.append(frames.append)
    client.on_data_description_received_event.handlers.append(described)
    with client:
        print(f"server {client.server_info.application_name}, NatNet {client.protocol_version}")
        client.request_modeldef()
        client.run_async()
        time.sleep(DURATION_S)
        client.stop_async()
    print(f"{len(frames) / DURATION_S:.0f} frames per second")
    for body in frames[-1].rigid_bodies if frames else ():
        x, y, z = body.pos
        print(
            f"{names.get(body.id_num, body.id_num)}: {x:.4f} {y:.4f} {z:.4f} m, "
            f"{'tracked' if body.tracking_valid else 'lost'}"
        )
    if not (frames and names):
        raise SystemExit("no frames or no description arrived")


if __name__ == "__main__":
    main()
