"""Speed of the estimator as ratios within one run: our engines against filterpy, and a rewind of history.

One step is one prediction and one update of each sensor kind on the same model. Medians of interleaved
rounds, so that what else the machine does hits every engine alike. Prints figures; judges nothing.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

import argparse
import json
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path as Folder

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from hil.config.estimator import EstimatorConfig
from hil.core.clock import NS_PER_S
from hil.core.signals import Measurements
from hil.estimator import make_estimator
from hil.robot.kinematics import WheelGeometry

sys.path.insert(0, str(Folder(__file__).parents[1] / "tests/estimator"))
from simulated_sensors import (
    CameraErrors,
    InertialErrors,
    Path,
    camera,
    cycles,
    inertial,
    start_state,
    wheel_samples,
)

ROUNDS = 15
GOALS = {"ekf": 10, "ukf": 25}
"""How many times faster than filterpy's each engine should be."""
REPLAY_GOALS_MS = {"ekf": 1.5, "ukf": 3.0}
"""Longest replay of 1.5 s of history."""


def seconds(work):
    """Processor time, which other programs on the machine disturb least."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def medians(works, rounds=ROUNDS):
    """Median duration of each of several works, run in turn."""
    times = [[seconds(w) for w in works] for _ in range(rounds)]
    return [statistics.median(column) for column in zip(*times, strict=True)]


def stream(duration_s=6.0, camera_rate_hz=200.0):
    """A straight drive as control cycles of 10 ms: wheels and inertial unit 100 Hz, camera 200 Hz."""
    rng = np.random.default_rng(0)
    t_s = 1.0 + np.arange(round(duration_s * 100) + 1) / 100.0
    rolled = 0.05 * (t_s - 1.0)
    path = Path(t_s, np.column_stack([rolled, np.zeros_like(t_s), np.zeros_like(t_s)]))
    wheels = wheel_samples(
        t_s,
        np.repeat(rolled[:, None] / 0.0254, 4, axis=1),
        np.zeros((len(t_s), 4)),
        np.full((len(t_s), 4), 2.0),
    )
    gyro = inertial(path, InertialErrors(), rng, on_wall=True)
    tracker = camera(path, CameraErrors(rate_hz=camera_rate_hz), rng)
    begin_ns = round(t_s[0] * NS_PER_S) - 1
    parts = cycles(begin_ns + 10_000_000, round(t_s[-1] * NS_PER_S), wheels, gyro, tracker)
    return start_state(begin_ns, path.pose[0]), tuple(parts)


def per_event(kind, engine, start, parts):
    """Work that runs a whole stream through one estimator, and its number of samples."""
    config = EstimatorConfig(kind=kind, engine=engine)
    estimator = make_estimator(config, WheelGeometry.nominal(), surface="wall")

    def work():
        estimator.reset(start)
        for m in parts:
            estimator.update(m)

    return work, sum(len(m.wheels) + len(m.gyro) + len(m.tracker) for m in parts)


def textbook(kind, n=8):
    """Filterpy as its book uses it: one prediction, a pose update and an inertial update; 8 states."""
    f = np.eye(n)
    f[0, 3] = f[1, 4] = f[2, 5] = 0.01
    pose, inertia = np.eye(n)[:3], np.eye(n)[[5, 2]]
    if kind == "ekf":
        filter_ = ExtendedKalmanFilter(n, 3)
        filter_.x, filter_.F, filter_.Q = np.zeros(n), f, 1e-4 * np.eye(n)

        def step():
            filter_.predict()
            filter_.update(np.zeros(3), lambda x: pose, lambda x: pose @ x, R=1e-2 * np.eye(3))
            filter_.update(np.zeros(2), lambda x: inertia, lambda x: inertia @ x, R=1e-2 * np.eye(2))

        return step
    points = MerweScaledSigmaPoints(n, 0.5, 2.0, 0.0)
    filter_ = UnscentedKalmanFilter(n, 3, 0.01, None, lambda x, dt: f @ x, points)
    filter_.Q = 1e-4 * np.eye(n)

    def step():
        filter_.predict()
        filter_.update(np.zeros(3), R=1e-2 * np.eye(3), hx=lambda x: pose @ x)
        filter_.sigmas_f = filter_.points_fn.sigma_points(filter_.x, filter_.P)
        filter_.update(np.zeros(2), R=1e-2 * np.eye(2), hx=lambda x: inertia @ x)

    return step


def rewind(kind, history_s):
    """Work that delivers one sample of `history_s` ago: everything since is replayed."""
    start, parts = stream(4.0)
    estimator = make_estimator(EstimatorConfig(kind=kind), WheelGeometry.nominal(), surface="wall")
    estimator.reset(start)
    for m in parts:
        estimator.update(m)
    last = parts[-1]
    old = next(m.gyro[0] for m in parts if m.gyro and m.gyro[0].stamp.t_ns >= last.t_ns - history_s * 1e9)
    count = [0]

    def work():
        count[0] += 1
        stamp = replace(old.stamp, t_ns=old.stamp.t_ns + 2000 * count[0], seq=10**6 + count[0])
        estimator.update(Measurements(0, last.t_ns, gyro=(replace(old, stamp=stamp),)))

    return work


def per_sample(kind):
    """Time of a sample (us) by our engine and by filterpy's on the same model, and of a textbook filter."""
    start, parts = stream()
    short = parts[:60]
    ours, count = per_event(kind, "compiled", start, short)
    theirs, _ = per_event(kind, "filterpy", start, short)
    book = textbook(kind)
    ours()
    a, b, c = medians([ours, theirs, lambda: [book() for _ in range(50)]])
    return {"ours_us": 1e6 * a / count, "filterpy_us": 1e6 * b / count, "textbook_us": 1e6 * c / 50}


def measured():
    """Every figure, by engine."""
    start, parts = stream()
    found = {kind: per_sample(kind) for kind in GOALS}
    works = [per_event(kind, "compiled", start, parts)[0] for kind in GOALS]
    for kind, took in zip(GOALS, medians(works, 5), strict=True):
        found[kind]["cycle_us"] = 1e6 * took / len(parts)
    works = [rewind(kind, 1.5) for kind in GOALS]
    for kind, took in zip(GOALS, medians(works, 25), strict=True):
        found[kind]["replay_ms"] = 1e3 * took
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object")
    as_json, found = parser.parse_args().json, measured()
    if as_json:
        print(json.dumps(found, indent=1))
        return
    print("same model and samples, 20 states, eight wheel rows (per sample, the cycle's share included)")
    for kind, it in found.items():
        print(
            f"  {kind}: ours {it['ours_us']:7.1f} us, filterpy {it['filterpy_us']:8.1f} us, "
            f"ratio 1/{it['filterpy_us'] / it['ours_us']:.0f} (goal 1/{GOALS[kind]}); "
            f"textbook filterpy with 8 states {it['textbook_us']:.0f} us per step"
        )
    for kind, it in found.items():
        print(f"control cycle of 10 ms with {kind}: {it['cycle_us']:.0f} us")
    for kind, it in found.items():
        goal = f"(goal {REPLAY_GOALS_MS[kind]} ms)"
        print(f"replay of 1.5 s of history (600 samples) with {kind}: {it['replay_ms']:.2f} ms {goal}")


if __name__ == "__main__":
    main()
