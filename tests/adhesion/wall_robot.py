"""The emulated robot on its wall, at the wire, which tells the truth about itself when it is asked.

First line on stdout: the endpoints. Then an answer for each line on stdin; it ends when stdin is closed.
"""

import json
import os
import select
import sys
from contextlib import suppress

from hil.bench import open_emulation
from hil.config.loading import load_bench


def main():
    with suppress(OSError):
        os.nice(-10)  # hardware does not wait for a busy host
    server = open_emulation(load_bench("emulated"), seed=int(sys.argv[1]))
    tell(server.endpoints())
    while True:
        server.step()
        if select.select([sys.stdin], [], [], 0)[0]:
            if not sys.stdin.readline():
                break
            server.world.sync_plant()
            truth = server.world.plant.truth()
            pose = [float(v) for v in truth.pose_body_in_wall]
            tell({"fallen": bool(truth.fallen), "pose": pose, "adhesion_n": float(truth.adhesion_n)})
    server.close()


def tell(said):
    sys.stdout.write(json.dumps(said) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
