"""Noise of the sensors from runs: what was put in is found, whatever its size, and its interval holds it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.config.estimator import EstimatorConfig
from hil.core.signals import Measurements, RobotState
from hil.estimator import make_estimator
from hil.estimator.sample_statistics import Change, Spread, about_a_line, blocks, random_walk
from hil.estimator.sensor_noise import measure
from tests.estimator.noisy_drives import GEOMETRY, Noise, driven

WHITE = ("gyro", "camera_position", "camera_heading", "mocap_position", "mocap_heading")
LARGER = {"as they are": (1.0, 1.0, 1.0), "mixed": (3.0, 1 / 3, 3.0)}


def true_noise(gyro, camera, mocap):
    own = Noise()
    scaled = {
        name: getattr(own, name) * camera
        for name in vars(own)
        if name.startswith("camera_") and name != "camera_scale"
    }
    scaled |= {name: getattr(own, name) * mocap for name in ("mocap_position", "mocap_heading")}
    return replace(own, gyro=own.gyro * gyro, **scaled)


@pytest.mark.parametrize("which", LARGER)
def test_what_was_put_in_is_found(which):
    true = true_noise(*LARGER[which])
    found = measure([driven(true, seed=7)], GEOMETRY)
    for name in WHITE:
        one, size = getattr(found, name), getattr(true, name)
        for state in (one.rest, one.both):
            assert state.sigma()[0] == pytest.approx(size, rel=0.2), name
        assert one.moving.sigma()[0] == pytest.approx(size, rel=0.4 if name == "gyro" else 0.2), name
    assert found.camera_walk.sigma()[0] == pytest.approx(true.camera_walk, rel=0.45)
    assert found.camera_turn.sigma()[0] == pytest.approx(true.camera_turn, rel=0.45)
    assert found.camera_creep.sigma()[0] < 0.3 * true.camera_position


def test_wheels_contradict_each_other_by_their_noise():
    """Per component of a wheel that rolls one way only: one of the two rows has it all."""
    found = measure([driven(Noise(wheel_step=4e-5), seed=3)], GEOMETRY)
    fine = measure([driven(Noise(wheel_step=1e-5), seed=3)], GEOMETRY)
    assert found.wheel_step.moving.sigma()[0] == pytest.approx(
        4.0 * fine.wheel_step.moving.sigma()[0], rel=0.1
    )
    assert 0.4e-5 < fine.wheel_step.moving.sigma()[0] < 1.2e-5


def test_a_sensor_that_is_not_there_has_no_figure():
    cycles = [Measurements(m.cycle, m.t_ns, m.wheels, (), (), m.mocap) for m in driven(Noise(), 5, 12.0)]
    found = measure([cycles], GEOMETRY)
    assert np.isnan(found.gyro.both.sigma()).all()
    assert np.isnan(found.camera_position.both.sigma()).all()
    assert found.mocap_position.rest.sigma()[0] == pytest.approx(Noise().mocap_position, rel=0.2)


def test_the_interval_holds_the_truth_as_often_as_it_says():
    rng, held = np.random.default_rng(1), 0
    for _ in range(300):
        t_s = np.arange(40) * 0.01
        _, low, high = about_a_line(t_s, 0.3 * t_s + 2.0 * rng.standard_normal(40)).sigma()
        held += low <= 2.0 <= high
    assert 270 <= held <= 297


def test_a_walk_is_told_from_white_noise():
    rng = np.random.default_rng(2)
    walk = np.cumsum(0.3 * rng.standard_normal((400, 50)).ravel() / np.sqrt(50.0)).reshape(400, 50)
    means = (walk + 0.5 * rng.standard_normal(walk.shape)).mean(axis=1)
    changes = [Change(float(d), 2.0 * 0.25 / 50.0, 1.0) for d in np.diff(means)]
    assert random_walk(changes).sigma()[0] == pytest.approx(0.3, rel=0.12)
    still = (0.5 * rng.standard_normal(walk.shape)).mean(axis=1)
    changes = [Change(float(d), 2.0 * 0.25 / 50.0, 1.0) for d in np.diff(still)]
    assert random_walk(changes).sigma()[0] < 0.05


def test_a_hole_is_no_block():
    t_s = np.concatenate([np.arange(0, 1.0, 0.01), np.arange(1.55, 2.0, 0.01)])
    spans = [(t_s[part][0], t_s[part][-1]) for part in blocks(t_s, 0.2)]
    assert all(b - a < 0.2 for a, b in spans)
    assert not any(1.0 < a < 1.6 for a, _ in spans)


def test_spreads_add_by_their_freedom():
    assert (Spread(4.0, 2.0) + Spread(2.0, 4.0)).variance == pytest.approx(1.0)
    assert Spread(4.0, 2.0).less(5.0).variance == 0.0


CONFIG = EstimatorConfig(
    gyro={"rate_rad_s": 2e-3}, tracker={"position_m": 4e-4, "heading_rad": 6e-4, "scale_sigma": 0.01}
)
FACTORS = ("noise_gyro", "noise_tracker_x", "noise_tracker_y", "noise_tracker_heading")


def at_work(cycles):
    """A filter that was told the usual noise, after these cycles, and its factors on the variances."""
    estimator = make_estimator(CONFIG, GEOMETRY, surface="floor")
    estimator.reset(RobotState(0, np.zeros(3), np.zeros(3), np.eye(6) * 1e-8))
    for one in cycles:
        state = estimator.update(one)
    return estimator, state, [state.diagnostics[name] for name in FACTORS]


@pytest.mark.parametrize("times", [1 / 3, 1.0, 2.0, 3.0])
def test_a_running_filter_measures_noise_beyond_what_it_was_told(times):
    cycles = driven(true_noise(times, times, 1.0), seed=5, end_s=8.0)
    _, state, found = at_work(cycles)
    assert found == pytest.approx([times**2 if times > 1.0 else 1.0] * 4, rel=0.3)
    assert state.diagnostics["nis_mean_tracker"] == pytest.approx(1.0 if times >= 1.0 else 0.11, abs=0.3)


def test_what_changes_slowly_is_no_noise():
    """Scale, drift and outliers of a camera stay what they are: errors that innovations show."""
    wrong = replace(Noise(), camera_scale=1.3, camera_walk=6e-3, camera_turn=3e-3)
    cycles = list(driven(wrong, seed=5, end_s=8.0))
    for k in range(20, len(cycles), 40):
        first, *others = cycles[k].tracker
        leaps = replace(first, pose=first.pose + np.array([0.01, 0.0, 0.03]))
        cycles[k] = replace(cycles[k], tracker=(leaps, *others))
    _, state, found = at_work(cycles)
    assert found == [1.0] * 4
    assert state.diagnostics["nis_mean_tracker"] > 2.0


def test_measured_noise_outlives_a_new_beginning_from_the_latest_estimate_only():
    cycles = driven(true_noise(3.0, 3.0, 1.0), seed=5, end_s=3.0)
    estimator, state, found = at_work(cycles[:-1])
    for begin_ns, kept in ((state.t_ns, True), (state.t_ns - 1, False)):
        estimator.reset(replace(state, t_ns=begin_ns))
        later = estimator.update(cycles[-1]).diagnostics
        assert [later[name] for name in FACTORS] == pytest.approx(found if kept else [1.0] * 4, rel=0.1)
