"""Speed of calibration: cost evaluation against a plain Python loop, and whole calibrations, in one run.

Runs on the public recordings where they are found (HIL_DATA, else ../shared/data), else on generated
ones of the same number. Prints ratios and figures; judges nothing.
"""

from __future__ import annotations

import math
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

import argparse
import resource
import statistics
from dataclasses import replace
from itertools import count
from pathlib import Path
from unittest import mock

import numpy as np

from hil.calibration import problem as problems
from hil.calibration.blocks import reduce_recordings
from hil.calibration.calibrate import calibrate
from hil.calibration.evaluation import truth_window, wheel_steps
from hil.calibration.problem import PAPER, RECOMMENDED, Problem
from hil.calibration.synthetic import hidden_robot, make_set
from hil.recording.sources import read_recordings
from hil.robot.kinematics import WheelGeometry
from hil.vocabulary.clock import NS_PER_S, MonotonicClock

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


def compare_forms(recordings, cad):
    """Residuals and normal equations of neighbouring parameters: compiled, and by numpy on arrays."""
    if problems.compiled_pass() is None:
        print("numba is not installed: passes run on arrays")
        return
    for setting in (RECOMMENDED, *(replace(RECOMMENDED, model=m) for m in ("creep", "exact"))):
        taken_s = []
        for form in (problems.compiled_pass, lambda: None):
            with mock.patch.object(problems, "compiled_pass", form):
                problem = Problem(reduce_recordings(recordings, setting.block_s), setting, cad)
                at = (problem.nominal * (1 + 1e-5 * k) for k in count())
                problem.normal_terms(next(at))
                taken_s.append(seconds(lambda p=problem, at=at: p.normal_terms(next(at)), 20))
        compiled_s, arrays_s = taken_s
        print(
            f"normal equations, {setting.model:13} arrays {1e3 * arrays_s:5.1f} ms, "
            f"compiled {1e3 * compiled_s:5.1f} ms, ratio: {arrays_s / compiled_s:.1f}"
        )


def main():
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cost", action="store_true", help="no whole calibrations, which take a minute")
    cost_only = parser.parse_args().cost
    root = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("HIL_DATA", root.parent / "shared" / "data")) / "4wis4wid"
    if folder.is_dir():
        loaded = []
        print(f"loading {folder.name}: {seconds(lambda: loaded.append(read_recordings([folder]))):.2f} s")
        recordings = loaded[0]
    else:
        print("public recordings not found: generated ones are used")
        recordings = make_set(hidden_robot(0), 0)
    cad = WheelGeometry.nominal()
    samples = plain_samples(recordings)
    plain_s = seconds(lambda: plain_loop_cost(samples, cad), 3)
    problem = Problem(reduce_recordings(recordings, 0.1), PAPER, cad)
    rng = np.random.default_rng(0)
    z = problem.nominal
    fast_s = seconds(lambda: problem.objective(z * (1 + 1e-3 * rng.standard_normal(len(z)))), 50)
    print(f"cost evaluation: plain loop {plain_s * 1e3:.0f} ms, here {fast_s * 1e3:.2f} ms")
    print(f"ratio: {plain_s / fast_s:.0f}")
    compare_forms(recordings, cad)
    if cost_only:
        return
    for setting in (RECOMMENDED, PAPER):
        for method in ("lm", "interior-point", "ga", "pso"):
            result = calibrate(recordings, setting, CLOCK, method=method)
            print(
                f"{setting.name:12}{method:15}{result.wall_s:6.2f} s, "
                f"validation {result.validation_s:5.2f} s, "
                f"objective {result.fit.solution.objective:.5g}, J {result.cost_after:.3f}"
            )
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
