"""How many times faster than real time the emulated robot is, at its 1 kHz step: driving on the wall.

    python benchmarks/plant.py --seconds 20 --repeat 5

Ratios are simulated time over this process's processor time, so that other work on the machine does not
count; the best of the repetitions. Ends with 1 when the compiled physics is below the 150 that a campaign
of many virtual runs was planned with.
"""

from __future__ import annotations

import argparse
import json
import math
import time

import numpy as np

from hil.config.robot import RobotConfig
from hil.core.clock import nanoseconds
from hil.fakes.body_interface import JointCommand
from hil.fakes.plant import WallRobot, make_plant

_NEEDED = 150.0
_PERIOD_NS = nanoseconds(0.01)


def driving() -> WallRobot:
    """A robot of the series that drives up the wall at two thirds of its speed."""
    plant = make_plant(RobotConfig(), rng=np.random.default_rng(0))
    for wheel in range(4):
        plant.command(wheel, JointCommand("velocity", 3.0))
        plant.command(wheel + 4, JointCommand("position", math.radians(10.0)))
    plant.advance(nanoseconds(0.2))
    return plant


def ratio(plant: WallRobot, seconds: float, repeat: int, *, look: bool) -> float:
    """Simulated over processor time; with `look`, as in a control loop of 100 Hz that reads the truth."""
    best = 0.0
    for _ in range(repeat):
        begin, target_ns = time.process_time(), plant.t_ns + nanoseconds(seconds)
        if look:
            for t_ns in range(plant.t_ns, target_ns + 1, _PERIOD_NS):
                plant.advance(t_ns)
                plant.truth()
        else:
            plant.advance(target_ns)
        best = max(best, seconds / (time.process_time() - begin))
    return best


def main() -> int:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated seconds per repetition")
    parser.add_argument("--repeat", type=int, default=5)
    given = parser.parse_args()
    found: dict[str, object] = {"needed": _NEEDED}
    begin = time.process_time()
    plant = driving()
    found["first_call_s"] = round(time.process_time() - begin, 2)
    compiled = ratio(plant, given.seconds, given.repeat, look=False)
    found["compiled"] = round(compiled, 1)
    found["compiled_looked_at_100_hz"] = round(ratio(plant, given.seconds, given.repeat, look=True), 1)
    print(json.dumps(found))
    return 0 if compiled >= _NEEDED else 1


if __name__ == "__main__":
    raise SystemExit(main())
