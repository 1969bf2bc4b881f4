"""The emulated robot on its wall, at the wire, which reports the truth about itself when it is asked.

First line on stdout: the endpoints. Then an answer for each line on stdin, by the chips' own registers and
with the fastest that wheels and steering turned since the last; it ends when stdin is closed.
"""

import json
import os
import select
import sys
from contextlib import suppress

from hil.bench import open_emulation
from hil.config.loading import load_bench
from hil.fakes.servos.dynamixel.chip import ServoBus
from tests.patience import FANLESS


def main():
    with suppress(OSError):
        os.nice(-10)  # hardware does not wait for a busy host
    config = load_bench("emulated", overrides=FANLESS if "fanless" in sys.argv else {})
    server = open_emulation(config, seed=int(sys.argv[1]))
    (bus,) = [part for part in server.world._parts if isinstance(part, ServoBus)]
    tell(server.endpoints())
    fastest = [0.0, 0.0]
    while True:
        server.step()
        rates = [abs(float(rate)) for rate in server.world.plant.joints()[1]]
        fastest = [max(fastest[0], *rates[:4]), max(fastest[1], *rates[4:])]
        if select.select([sys.stdin], [], [], 0)[0]:
            if not sys.stdin.readline():
                break
            server.world.sync_plant()
            truth = server.world.plant.truth()
            pose = [float(v) for v in truth.pose_body_in_wall]
            tell(
                {
                    "fallen": bool(truth.fallen),
                    "pose": pose,
                    "adhesion_n": float(truth.adhesion_n),
                    "thrust_n": float(truth.thrust_n),
                    "torque": [bool(servo.table.get("torque_enable")) for servo in bus.servos],
                    "turning": [asked_to_turn(servo) for servo in bus.servos[:4]],
                    "wheels_rad_s": fastest[0],
                    "steering_rad_s": fastest[1],
                }
            )
            fastest = [0.0, 0.0]
    server.close()


def asked_to_turn(servo):
    """Whether a goal turns the wheel, and the bus watchdog has not tripped."""
    return bool(servo.table.get("goal_velocity")) and not servo.axis.tripped


def tell(said):
    sys.stdout.write(json.dumps(said) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
