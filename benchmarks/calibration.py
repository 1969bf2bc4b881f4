"""Speed of calibration: cost evaluation against a plain Python loop, and whole calibrations, in one run.

Runs on the public recordings where they are found (HIL_DATA, else ../shared/data), else on generated
ones of the same number. Prints ratios and figures; judges nothing.
"""

from __future__ import annotations

import math
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

import argparse
import json
import resource
import statistics
from pathlib import Path

import numpy as np

from hil.calibration.calibrate import calibrate
from hil.calibration.problem import PAPER, RECOMMENDED, Problem
from hil.calibration.synthetic import hidden_robot, make_set
from hil.core.clock import NS_PER_S, MonotonicClock
from hil.datasets.fit_blocks import reduce_recordings
from hil.datasets.read import read_recordings
from hil.datasets.sampling import truth_window, wheel_steps
from hil.robot.kinematics import WheelGeometry

CLOCK = MonotonicClock()


def seconds(work, repeat=1):
    """Median duration of `work()`, s."""
    out = []
    for _ in range(repeat):
        begin = CLOCK.now_ns()
        work()
        out.append((CLOCK.now_ns() - begin) / NS_PER_S)
    return statistics.median(out)


def plain_loop_cost(samples, g):
    """The paper's cost the plain way: every sample, every wheel, one after the other."""
    total = 0.0
    for (x, y, theta), steps in samples:
        for rotation, steering, (tx, ty, tth) in steps:
            vx = vy = w = 0.0
            for i in range(4):
                c, s = math.cos(steering[i]), math.sin(steering[i])
                v = rotation[i] * g.radius_m[i]
                vx += v * c / 4
                vy += v * s / 4
                w += v * (-g.y_m[i] * c + g.x_m[i] * s) / (4 * (g.x_m[i] ** 2 + g.y_m[i] ** 2))
            c, s = math.cos(theta), math.sin(theta)
            x, y, theta = x + c * vx - s * vy, y + s * vx + c * vy, theta + w
            total += (x - tx) ** 2 + (y - ty) ** 2 + (theta - tth) ** 2
    return total


def plain_samples(recordings):
    """Wheel steps and truth at every ground-truth stamp, as Python lists."""
    out = []
    for r in recordings:
        at_s, truth = truth_window(r)
        rotation, steering = wheel_steps(r, at_s, "position")
        out.append(
            (
                tuple(truth[0]),
                list(zip(rotation.tolist(), steering.tolist(), truth[1:].tolist(), strict=True)),
            )
        )
    return out


def compare_cost(recordings, cad):
    """Time (ms) of one evaluation of the cost: ours, and a plain Python loop."""
    samples = plain_samples(recordings)
    plain_s = seconds(lambda: plain_loop_cost(samples, cad), 3)
    problem = Problem(reduce_recordings(recordings, 0.1), PAPER, cad)
    rng = np.random.default_rng(0)
    z = problem.nominal
    fast_s = seconds(lambda: problem.objective(z * (1 + 1e-3 * rng.standard_normal(len(z)))), 50)
    return {"ours_ms": 1e3 * fast_s, "loop_ms": 1e3 * plain_s}


def whole(recordings):
    """Print how long whole calibrations take."""
    for setting in (RECOMMENDED, PAPER):
        for method in ("lm", "interior-point", "ga", "pso"):
            result = calibrate(recordings, setting, CLOCK, method=method)
            print(
                f"{setting.name:12}{method:15}{result.wall_s:6.2f} s, "
                f"validation {result.validation_s:5.2f} s, "
                f"objective {result.fit.solution.objective:.5g}, J {result.cost_after:.3f}"
            )


def main():
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="the ratios as one JSON object, nothing else")
    as_json = parser.parse_args().json
    root = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("HIL_DATA", root.parent / "shared" / "data")) / "4wis4wid"
    loaded, loading_s = [], 0.0
    if folder.is_dir():
        loading_s = seconds(lambda: loaded.append(read_recordings([folder])))
    recordings = loaded[0] if loaded else make_set(hidden_robot(0), 0)
    cad = WheelGeometry.nominal()
    cost = compare_cost(recordings, cad)
    if as_json:
        print(json.dumps({"cost": cost}, indent=1))
        return
    if loaded:
        print(f"loading {folder.name}: {loading_s:.2f} s")
    else:
        print("public recordings not found: generated ones are used")
    print(f"cost evaluation: plain loop {cost['loop_ms']:.0f} ms, here {cost['ours_ms']:.2f} ms")
    print(f"ratio: {cost['loop_ms'] / cost['ours_ms']:.0f}")
    whole(recordings)
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
