"""Sensor noise: what goes into the record is what the samples show, whatever an emulation's table says."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hil.config.estimator import EstimatorConfig
from hil.config.loading import load_bench
from hil.core.errors import DeviceError
from hil.core.signals import RobotState
from hil.estimator.noise_matching import DrivenRun, usual_nis
from hil.estimator.tuning import with_values
from hil.procedures import sensor_noise
from hil.recording.runs import START_COVARIANCE
from tests.estimator.noisy_drives import GEOMETRY, Noise, driven
from tests.selected import every


class TakenAway:
    """An emulation's table that nothing may look into."""

    def __getattr__(self, name):
        raise AssertionError(f"a figure of the emulation was read: {name}")


class Run:
    """What `evaluate` asks of a run, on a bench whose emulation's table is gone."""

    def __init__(self):
        config = load_bench("emulated_floor").model_copy(update={"emulation": TakenAway()})
        self.source = SimpleNamespace(config=config)
        self.values, self.tables = {}, []

    def measure(self, name, value):
        self.values[name] = value

    def table(self, title, head, rows, note=""):
        self.tables.append(rows)

    def progress(self, what, done, total):
        assert done <= total


@pytest.fixture
def learnt(monkeypatch):
    """Values that were left for the record."""
    found = {}
    monkeypatch.setattr(sensor_noise, "leave_part", lambda ctx, name, values, figures: found.update(values))
    monkeypatch.setattr(sensor_noise, "write_fragment", lambda ctx, tree, why: None)
    return found


def runs_of(noise, seed):
    cycles = driven(noise, seed)
    rest = tuple(m for m in cycles if m.t_ns < 4e9)
    moving = tuple(m for m in cycles if m.t_ns >= 3e9)
    start = RobotState(moving[0].t_ns - 10_000_000, np.zeros(3), np.zeros(3), START_COVARIANCE)
    return rest, DrivenRun(moving, start)


def noise_of(gyro, camera):
    own = Noise()
    scaled = {k: v * camera for k, v in vars(own).items() if k.startswith("camera_") and k != "camera_scale"}
    return replace(own, gyro=gyro * own.gyro, **scaled)


@pytest.mark.parametrize(("gyro", "camera"), every(2, [(3.0, 1 / 3), (1.0, 1.0), (1 / 3, 3.0)]))
def test_the_filter_is_as_sure_as_it_may_be_with_what_was_found(learnt, gyro, camera):
    noise = noise_of(gyro, camera)
    rest, run = runs_of(noise, seed=4)
    bench = SimpleNamespace(geometry=GEOMETRY, config=SimpleNamespace(estimator=EstimatorConfig()))
    ctx = Run()
    bench.config.environment = ctx.source.config.environment
    sensor_noise.evaluate(ctx, bench, rest, [run])
    assert learnt["estimator.gyro.rate_rad_s"] == pytest.approx(noise.gyro, rel=0.2)
    assert learnt["estimator.tracker.position_m"] == pytest.approx(noise.camera_position, rel=0.2)
    unseen = runs_of(noise, seed=5)[1]
    config = with_values(EstimatorConfig(), {k.removeprefix("estimator."): v for k, v in learnt.items()})
    nis = usual_nis(config, [unseen], GEOMETRY, "floor")
    default = usual_nis(EstimatorConfig(), [unseen], GEOMETRY, "floor")
    for sensor in ("wheels", "gyro", "tracker"):
        assert 0.7 < nis[sensor] < 1.4, (sensor, nis)
    assert not 0.7 < default["gyro"] < 1.4


def test_wheels_that_did_not_turn_are_named(learnt):
    rest, _ = runs_of(Noise(), seed=1)
    bench = SimpleNamespace(geometry=GEOMETRY, config=SimpleNamespace(estimator=EstimatorConfig()))
    with pytest.raises(DeviceError, match="no motion"):
        sensor_noise.evaluate(Run(), bench, rest, [])
