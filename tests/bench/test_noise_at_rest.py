"""The doctor on noise at rest: beside the record, or beside what the estimator takes it for."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hil.bench.doctor.examination import noise_at_rest
from hil.bench.loop_settings import alignment_parameters
from hil.config.loading import load_bench
from hil.config.robot_record import Figure, NewPart, Part, RobotRecord
from hil.config.robot_record.overlay import identity
from hil.core.signals import Inputs, MocapSample, Stamp
from hil.loop.alignment import Alignment

KEPT_M = 2e-5


def seen(sigma_m, count=300):
    rng = np.random.default_rng(3)
    samples = []
    for k in range(count):
        t_ns = k * 10_000_000
        samples.append(mocap(Stamp(t_ns, t_ns, k), sigma_m * rng.standard_normal(3)))
    return Inputs(0, 0, mocap=tuple(samples))


def mocap(stamp, position):
    return MocapSample(stamp, position, np.array([1.0, 0.0, 0.0, 0.0]), True, 0.0, 1e-4)


def bench(tmp_path, *, measured):
    config = load_bench("emulated_delivered")
    if not measured:
        return config
    record = RobotRecord(tmp_path / "robot")
    part = Part(
        procedure="sensor_noise",
        verdict="PASS",
        measured="2026-11-22T10:00:00+00:00",
        bench=config.name,
        values={"estimator.mocap.position_m": KEPT_M},
        figures={"mocap_position_rest": Figure(value=KEPT_M, sigma=1e-6, unit="m")},
    )
    record.add({"noise": NewPart(part)}, identity(config), created="2026-11-22T12:00:00+00:00", why="a test")
    return load_bench("emulated_delivered", overrides={"record.folder": str(record.folder)})


def position(config, sigma_m):
    found = noise_at_rest(config, Alignment(alignment_parameters(config)).measure(seen(sigma_m)))
    return next(f for f in found if f.check.startswith("position"))


@pytest.mark.parametrize(
    ("times", "level", "word"), [(1.0, "ok", ""), (3.0, "warning", "noisier"), (1 / 3, "ok", "better")]
)
def test_noise_is_held_against_the_record(tmp_path, times, level, word):
    told = position(bench(tmp_path, measured=True), times * KEPT_M)
    assert told.level == level
    assert word in told.found
    nis = float(re.search(r"mean NIS ([\d.]+)", told.found)[1].rstrip("."))
    assert nis == pytest.approx(times**2, rel=0.15)
    assert ("noisier" in told.found) == (times > 2)


def test_without_a_record_only_what_is_noisier_than_taken_for_warns(tmp_path):
    config = bench(tmp_path, measured=False)
    assert position(config, 1e-5).level == "ok"
    assert position(config, 5e-3).level == "warning"
