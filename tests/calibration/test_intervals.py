"""Intervals of a calibration hold the truth, also where contacts obey another law than the fit believes."""

import numpy as np
import pytest

from hil.calibration import identifiability as judged
from hil.calibration.calibrate import calibrate
from hil.calibration.fitting import fit
from hil.calibration.identifiability import data_information, group_shift, standard_errors
from hil.calibration.problem import RECOMMENDED, make_setting
from hil.calibration.synthetic import hidden_robot, make_set
from hil.core.clock import MonotonicClock
from hil.datasets.fit_blocks import reduce_recordings
from hil.robot.kinematics import WheelGeometry

CAD = WheelGeometry.nominal()
BRIEF = ("line_x", "line_y", "circle_ccw", "rotation_cw")


def off(found, intervals, truth):
    """Errors of the combinations that the data determine, over the half widths of their intervals."""
    problem, z = found.problem, found.solution.z
    spread = problem.prior_std
    values, vectors = np.linalg.eigh(spread[:, None] * data_information(problem, z) * spread)
    ways = vectors[:, values > 1.0] / spread[:, None]
    half = intervals.quantile * np.sqrt(np.einsum("ak,ab,bk->k", ways, intervals.covariance, ways))
    return np.abs(ways.T @ (z - truth)) / half


def test_the_spread_over_groups_is_the_covariance_of_independent_errors():
    """Exact law: over all unit errors, what the groups add sums up to the inverse information, also where one
    group alone shows a combination."""
    rng = np.random.default_rng(0)
    slopes = rng.normal(size=(40, 5))
    slopes[:32, 4] *= 1e-3  # shown by the last group alone
    groups = np.repeat(np.arange(5), 8)
    total = slopes.T @ slopes
    residuals = np.eye(40) - slopes @ np.linalg.solve(total, slopes.T)
    spread = np.zeros((5, 5))
    for group in range(5):
        rows = slopes[groups == group]
        moved = np.array(
            [group_shift(total, rows.T @ rows, rows.T @ e[groups == group]) for e in residuals.T]
        )
        spread += moved.T @ moved
    np.testing.assert_allclose(spread, np.linalg.inv(total), rtol=1e-9, atol=1e-12)


def test_what_nothing_shows_adds_no_spread():
    moved = group_shift(np.diag([4.0, 0.0]), np.diag([2.0, 0.0]), np.array([1.0, 0.0]))
    np.testing.assert_allclose(moved, [0.25 * np.sqrt(2.0), 0.0])


def test_that_contacts_may_obey_another_law_is_in_the_intervals(monkeypatch):
    """Friction that goes with slip, read as dry friction: what only that law claims is far off."""
    robot = hidden_robot(1)
    recordings = make_set(robot, 1, BRIEF, repetitions=2, slip_share=0.0)
    found = fit(reduce_recordings(recordings, 0.3), make_setting("recommended", model="dry-friction"), CAD)
    truth = robot.geometry.vector()
    assert off(found, standard_errors(found, CAD), truth).max() < 1.5
    monkeypatch.setattr(judged, "model_freedom", lambda fitted, inverse: np.zeros_like(inverse))
    assert off(found, standard_errors(found, CAD), truth).max() > 3.0


def test_what_the_data_do_not_show_is_as_uncertain_as_a_workshop_leaves_it():
    robot = hidden_robot(3)
    found = fit(
        reduce_recordings(make_set(robot, 3, ["line_x"], 3), 0.1),
        make_setting("recommended", model="exact"),
        CAD,
    )
    unseen = judged.identifiability(found).std_ratio > 0.97
    assert unseen.any()
    std = standard_errors(found, CAD).std[unseen]
    assert np.all(std >= 0.9 * RECOMMENDED.tolerance * found.problem.prior_std[unseen])


def test_a_law_of_contact_claims_more_than_kinematics_show():
    robot = hidden_robot(0, contact="coulomb")
    recordings = make_set(robot, 0, repetitions=1, slip_share=0.0)
    found = fit(reduce_recordings(recordings, 0.3), make_setting("recommended", model="dry-friction"), CAD)
    spectrum = judged.identifiability(found)
    assert spectrum.determined_without_contact_law <= 7 < spectrum.determined


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("contact", ["viscous", "coulomb", "elastic"])
def test_intervals_hold_the_truth_of_ten_robots(contact):
    """`benchmarks/interval_coverage.py` does the same on emulated benches."""
    inside = []
    for seed in range(10):
        robot = hidden_robot(seed, contact=contact)
        result = calibrate(make_set(robot, seed, repetitions=3), RECOMMENDED, MonotonicClock(), seed=seed)
        inside += (off(result.fit, result.intervals, robot.geometry.vector()) <= 1.0).tolist()
    assert np.mean(inside) >= 0.88
