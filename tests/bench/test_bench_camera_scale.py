"""A measured scale of the camera reaches alignment and filter; without one nothing is other than before."""

import logging

import numpy as np
import pytest

from hil.bench import open_bench
from hil.config.loading import load_bench, validate
from hil.core.errors import ConfigError
from hil.robot.trajectories import line
from tests.patience import FANLESS

KNOWN = {"tracker.scale": 1.01, "tracker.scale_sigma": 0.0012}
SIGMA = "estimator.tracker.scale_sigma"


def opened(**overrides):
    return open_bench("emulated", overrides={**FANLESS, **overrides})


def test_the_measured_uncertainty_is_the_prior_and_the_scale_the_alignments():
    with opened(**KNOWN) as bench:
        assert bench.config.estimator.tracker.scale_sigma == 0.0012
        assert bench.model.alignment_parameters.tracker_scale == 1.01
        state = bench.observe(0.05).records[-1].state
        assert state.diagnostics["scale_sigma"] == pytest.approx(0.0012, rel=1e-3)


def test_what_the_file_says_of_the_prior_stays_and_a_difference_is_a_warning(caplog):
    caplog.set_level(logging.WARNING, "hil")
    with opened(**KNOWN, **{SIGMA: 0.004}) as bench:
        assert bench.config.estimator.tracker.scale_sigma == 0.004
    assert "tracker.scale_sigma = 0.0012 was measured" in caplog.text


@pytest.mark.parametrize(
    "fixed", [{"estimator.preset": "paper"}, {SIGMA: 0.0, "estimator.wheel_scale_sigma": 0.01}]
)
def test_a_scale_that_is_switched_off_stays_off(fixed):
    with opened(**KNOWN, **fixed) as bench:
        assert bench.config.estimator.tracker.scale_sigma == 0.0


def test_a_recordings_header_gives_the_same_bench_again(caplog):
    with opened(**KNOWN) as bench:
        again = validate(bench.header()["config"], "header")
        with open_bench(again) as other:
            assert other.config.estimator == bench.config.estimator
            assert other.model.alignment_parameters == bench.model.alignment_parameters
    assert "was measured" not in caplog.text


@pytest.mark.parametrize(("key", "value"), [("scale", 2.0), ("scale", float("nan")), ("scale_sigma", 0.0)])
def test_an_impossible_scale_is_refused(key, value):
    with pytest.raises(ConfigError) as refused:
        load_bench("emulated", overrides={f"tracker.{key}": value})
    assert f"tracker.{key}" in str(refused.value.problems)


def end_error_m(seed, **overrides):
    """How far a robot ends from its goal up the wall."""
    with open_bench("emulated", seed=seed, overrides={**FANLESS, **overrides}) as bench:
        start = bench.settle(0.3)
        way = line(start, np.add(start, [0.3, 0.0, 0.0]), duration_s=5.4)
        motion = bench.drive(way, hold_s=0.3, start_pose=start)
        return float(bench.truth().pose_body_in_wall[0] - motion.reference[-1, 0])


@pytest.mark.parametrize("seed", [5, pytest.param(6, marks=pytest.mark.long)])
def test_a_known_scale_takes_two_thirds_off_the_end_error_of_a_climb(seed):
    """On the wall nothing on board can tell the camera's scale from creep: a camera far off, once known."""
    camera = {"emulation.tracker": {"scale_sigma": 0.012, "position_walk_m_sqrt_m": 0.001}}
    true = scale_of(seed, camera)
    assert 0.02 < abs(true - 1.0) < 0.03
    before = end_error_m(seed, **camera)
    after = end_error_m(seed, **camera, **{"tracker.scale": true, "tracker.scale_sigma": 0.001})
    assert abs(after) < abs(before) / 3.0


def scale_of(seed, overrides):
    from hil.fakes.tracker.t265.chip import T265

    world = open_bench("emulated", seed=seed, overrides={**FANLESS, **overrides}).world
    return next(p for p in world._parts if isinstance(p, T265)).odometry.scale
