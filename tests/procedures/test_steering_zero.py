"""Hidden steering zeros come back; an encoder that lies about its zero is caught by the motion."""

import numpy as np
import pytest
from procedure_runs import assert_covered, assert_covered_over_twenty_seeds, fragment_of, run, true_world

from hil.procedures.steering_zero.fit import fit_axis

SHORT = {"sweep_s": 4.0, "sweeps": 1, "leg_m": 0.2, "legs": 1}


def recover(seed, folder, **source):
    """Errors of the zeros over their stated uncertainties."""
    believed = np.random.default_rng([seed, 9]).uniform(-0.02, 0.02, 4).round(4).tolist()
    overrides = {"alignment.steer_zero_rad": believed}
    done = run("steering_zero", folder, SHORT, seed=seed, overrides=overrides, **source)
    assert done.result.verdict.value in ("PASS", "MARGINAL"), done.failed or done.result.error
    done.assert_held()
    truth = -true_world(source.get("bench", "emulated_floor"), seed).plant.parameters.steering_offset_rad
    assert fragment_of(folder)["alignment"]["steer_zero_rad"] == pytest.approx(truth, abs=np.radians(0.1))
    wheels = ("FL", "BL", "BR", "FR")
    found = np.array([done.values[f"steer_{w}.zero"] for w in wheels])
    half = np.array([done.values[f"steer_{w}.zero_uncertainty"] for w in wheels])
    return ((found - np.degrees(truth)) / half).tolist(), done


def test_hidden_steering_zeros_come_back_and_are_driven(tmp_path):
    ratios, done = recover(1, tmp_path / "run")
    assert_covered(ratios, few=True)
    assert done.values["applied.worst_heading"] < 0.1
    assert abs(done.values["common.disagreement"]) < 0.2


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_true_zeros_lie_within_the_stated_intervals_over_twenty_seeds(tmp_path):
    assert_covered_over_twenty_seeds(recover, tmp_path)


@pytest.mark.long
def test_zeros_come_back_on_the_wall_too(tmp_path):
    assert_covered(recover(3, tmp_path / "run", bench="emulated")[0], few=True)


def test_an_encoder_with_a_wrong_zero_is_caught_by_the_motion(tmp_path):
    brief = SHORT | {"sweep_s": 2.0, "leg_m": 0.1}
    done = run("steering_zero", tmp_path / "run", brief, faults=("encoder.BR:wrong,offset_rad=0.05",))
    assert done.result.exit_code == 1
    assert "common.disagreement" in done.failed
    done.assert_held()


def test_an_encoder_that_does_not_measure_ends_the_run(tmp_path):
    done = run("steering_zero", tmp_path / "run", SHORT, faults=("encoder.FL:off@1.6",))
    assert done.result.exit_code == 3
    assert "axis FL" in done.result.error.message
    done.assert_held()


def test_the_fit_reports_zero_play_and_magnet_apart():
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 16.0, 0.005)
    steering = np.radians(100.0) * np.sin(2.0 * np.pi * t / 8.0)
    way = np.sign(np.cos(2.0 * np.pi * t / 8.0))
    zero, play, once, twice = 0.012, 0.004, 0.006, 0.002
    magnet = once * np.sin(steering + 0.7) + twice * np.sin(2.0 * steering - 1.1)
    encoder = steering + zero - 0.5 * play * way + magnet + rng.normal(0.0, 0.001, len(t))
    fit = fit_axis(t, steering, encoder, 4)
    assert fit.offset_rad == pytest.approx(zero, abs=fit.uncertainty_rad)
    assert fit.uncertainty_rad < 0.001
    assert fit.backlash_rad == pytest.approx(play, abs=2e-4)
    assert fit.eccentricity_rad == pytest.approx(once, rel=0.1)
    assert fit.residual_rad == pytest.approx(0.001, rel=0.1)
