"""Calibration: derivatives, solvers that agree, truth that comes back, what the data cannot tell."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.calibrate import calibrate
from hil.calibration.evaluation import evaluate, track
from hil.calibration.fitting import fit
from hil.calibration.identifiability import identifiability, play_shift, standard_errors
from hil.calibration.motion_models import make_model
from hil.calibration.problem import PAPER, RECOMMENDED, Problem, make_setting
from hil.calibration.solvers import METHODS, interior_point, levenberg_marquardt, solve
from hil.calibration.synthetic import OTHER_MOTIONS, hidden_robot, make_set
from hil.core.clock import MonotonicClock
from hil.core.errors import DataError, UsageError
from hil.datasets.fit_blocks import reduce_recordings
from hil.datasets.sampling import truth_window
from hil.robot.kinematics import WheelGeometry
from hil.support.progress import WHOLE
from tests.selected import every

CAD = WheelGeometry.nominal()
CLOCK = MonotonicClock()


@pytest.fixture(scope="module")
def recordings():
    return make_set(hidden_robot(1), 1, repetitions=2)


def some_z(seed=0):
    rng = np.random.default_rng(seed)
    z = CAD.vector() * (1 + 0.01 * rng.standard_normal(16))
    z[12:] = 0.01 * rng.standard_normal(4)
    return z


@pytest.mark.parametrize("name", ["exact", "paper", "dry-friction", "creep"])
def test_motion_jacobian_matches_differences(recordings, name):
    q = reduce_recordings(recordings[:3], 0.3).wheel_rad.reshape(-1, 8)
    z = some_z()
    tyres = replace(CAD, load=np.array([0.5, 1.4, 1.5, 0.6]), creep_ratio=0.7)
    _, jacobian = make_model(name, q, tyres).motion_jacobian(z)
    for k in range(16):
        h = 1e-6 * np.eye(16)[k]
        slope = (make_model(name, q, tyres).motion(z + h) - make_model(name, q, tyres).motion(z - h)) / 2e-6
        tolerance = 2e-3 if name == "dry-friction" else 1e-8
        assert np.median(np.abs(jacobian[:, k].T - slope)) <= tolerance * max(np.abs(slope).max(), 1.0)


def test_gauss_newton_gradient_is_the_gradient_of_the_objective(recordings):
    for setting in (PAPER, replace(RECOMMENDED, model="exact")):
        problem = Problem(reduce_recordings(recordings, 0.3, setting.signal), setting, CAD)
        z = some_z()[: len(problem.nominal)]
        value, half_gradient, _ = problem.gradient_terms(z)
        assert value == pytest.approx(problem.objective(z))
        for k in range(len(z)):
            h = 1e-7 * np.eye(len(z))[k]
            slope = (problem.objective(z + h) - problem.objective(z - h)) / 2e-7
            assert 2 * half_gradient[k] == pytest.approx(slope, rel=1e-4, abs=1e-3 * value)


@pytest.mark.parametrize("setting", every(2, [PAPER, RECOMMENDED]), ids=lambda s: s.name)
def test_all_four_methods_meet(recordings, setting):
    blocks = reduce_recordings(recordings, setting.block_s, setting.signal)
    found = {m: fit(blocks, setting, CAD, method=m, seed=3) for m in METHODS}
    best = min(f.solution.objective for f in found.values())
    for method, result in found.items():
        assert result.solution.objective <= 1.01 * best, method
        z = result.solution.z
        assert np.all(z >= result.problem.lower - 1e-12)
        assert np.all(z <= result.problem.upper + 1e-12)
        polished = result.solution.objective_before_polish is not None
        assert polished == (method in ("ga", "pso"))


@pytest.mark.parametrize(
    ("model", "methods"), every(3, [("paper", METHODS[:2]), ("paper", METHODS), ("creep", METHODS[:2])])
)
def test_all_methods_keep_to_one_box_and_meet_in_it(recordings, model, methods):
    """Steering zeros that no prior holds: 0.05 is 5 % of a length, and 0.05 rad of an angle."""
    setting = make_setting("recommended", model=model, signal="velocity", bounds=0.05)
    blocks = reduce_recordings(recordings, 0.3, setting.signal)
    found = {m: fit(blocks, setting, CAD, method=m, seed=3) for m in methods}
    best = min(f.solution.objective for f in found.values())
    named = {m: set(identifiability(f).at_bound) for m, f in found.items()}
    for method, result in found.items():
        moved = np.abs(result.solution.z - CAD.vector())
        assert np.all(moved[:12] <= 0.05 * np.abs(CAD.vector()[:12]) + 1e-12), method
        assert np.all(moved[12:] <= 0.05 + 1e-12), method
        assert result.solution.objective <= 1.001 * best, method
        assert named[method] == named["lm"] != set()


@pytest.mark.long
def test_all_methods_say_the_same_of_intervals_where_bounds_decide(recordings):
    """Some end on a bound and some just inside it: standard errors had differed by a factor of three."""
    blocks = reduce_recordings(recordings, 0.1, "velocity")
    setting = replace(PAPER, bounds=0.02)
    fits = [fit(blocks, setting, CAD, method=method) for method in METHODS]
    first, *others = [standard_errors(found, CAD) for found in fits]
    held = [identifiability(found).at_bound for found in fits]
    assert 0 < len(held[0]) < 12
    assert held[1:] == held[:1] * (len(METHODS) - 1)
    for other in others:
        np.testing.assert_allclose(other.std, first.std, rtol=0.03)
        np.testing.assert_allclose(other.twist_std, first.twist_std, rtol=0.03)


def test_a_wheel_on_an_axis_of_the_body_is_not_held_there():
    """A relative prior or bound of a position that is zero on paper would otherwise have no width."""
    cross = WheelGeometry([0.2, 0.0, -0.2, 0.0], [0.0, 0.2, 0.0, -0.2], np.full(4, 0.04))
    robot = hidden_robot(3)
    data = make_set(robot, 3, ["rotation_ccw", "line_x"], 1)
    for setting in (PAPER, replace(RECOMMENDED, model="exact")):
        problem = Problem(reduce_recordings(data, 0.3), setting, cross)
        assert np.all(problem.prior_std > 0)
        assert np.all(problem.upper > problem.lower)


def test_a_steering_angle_off_in_one_motion_shifts_the_result_as_foreseen(recordings):
    """Play: re-fitting recordings whose second wheel steers 0.1 mrad beside what it reports.

    The truth is what the model itself makes of the wheels, so that no misfit bends the cost.
    """
    setting, off_rad = replace(RECOMMENDED, model="exact", robust=False, choose_model=False), 1e-4
    runs = [track(r, WheelGeometry.from_vector(some_z()), "exact") for r in recordings]
    fitting = [
        replace(r, truth_t_s=truth_window(r)[0], truth_pose=run.odometry)
        for r, run in zip(recordings, runs, strict=True)
    ]
    moved = [
        replace(r, steering_rad=r.steering_rad + off_rad * np.eye(4)[1]) if r.motion == "line_x" else r
        for r in fitting
    ]
    first, second = (fit(reduce_recordings(rs, 0.1), setting, CAD) for rs in (fitting, moved))
    _, _, information = first.problem.normal_terms(first.solution.z)
    total = information.sum(axis=0) + np.diag(first.problem.prior_precision())
    own = np.array(first.problem.blocks.motions) == "line_x"
    foreseen = off_rad * play_shift(first.problem, np.linalg.inv(total), information, own)[:, 1]
    found = second.solution.z - first.solution.z
    scale = first.problem.prior_std
    assert np.linalg.norm(found / scale) > 0.01 * off_rad / scale[13]
    assert np.linalg.norm((found - foreseen) / scale) < 0.05 * np.linalg.norm(found / scale)


@pytest.mark.long
@pytest.mark.parametrize("setting", [PAPER, RECOMMENDED], ids=lambda s: s.name)
@pytest.mark.parametrize("method", ["ga", "pso"])
def test_stochastic_methods_meet_on_ten_seeds(recordings, setting, method):
    blocks = reduce_recordings(recordings, setting.block_s, setting.signal)
    best = fit(blocks, setting, CAD, method="interior-point").solution.objective
    for seed in range(10):
        assert fit(blocks, setting, CAD, method=method, seed=seed).solution.objective <= 1.01 * best


def test_interior_point_and_lm_find_scipys_optimum_in_the_box(recordings):
    from scipy.optimize import least_squares

    problem = Problem(reduce_recordings(recordings, 0.3, "velocity"), PAPER, CAD)

    def residuals(z):
        return (problem.errors(z) * problem._row_factors()).ravel()

    reference = least_squares(
        residuals,
        problem.nominal,
        bounds=(problem.lower, problem.upper),
        x_scale=0.01 * np.abs(problem.nominal),
    )
    best = 2 * reference.cost
    for method in (interior_point, levenberg_marquardt):
        assert method(problem, problem.nominal).objective <= 1.005 * best


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.long) for n in range(1, 20))])
def test_injected_truth_comes_back_through_bad_data(seed):
    """Slip bursts and a corrupted file in the fit; motions outside it predicted within 1.8 mm."""
    robot = hidden_robot(seed)
    result = calibrate(make_set(robot, seed, corrupted="circle_cw_2"), RECOMMENDED, CLOCK, validate=False)
    assert "circle_cw_2" in result.rejected
    assert any("circle_cw_2" in line for line in result.warnings)
    test = make_set(robot, seed + 100, OTHER_MOTIONS, 2, slip_share=0, run_to_run=0)
    after = evaluate([track(r, result.geometry, result.setting.model, "position") for r in test])
    before = evaluate([track(r, CAD, "exact", "position") for r in test])
    assert after["mean"]["rmse_position_m"] <= 1.8e-3
    if seed == 0:
        assert before["mean"]["rmse_position_m"] > 4 * after["mean"]["rmse_position_m"]


def test_the_cross_validations_tell_how_far_all_of_them_are(recordings):
    reported = []
    few = [r for r in recordings if r.motion in ("line_x", "line_y")]
    setting = replace(RECOMMENDED, model="exact", choose_model=False)
    calibrate(few, setting, CLOCK, report=lambda *now: reported.append(now))
    whole = [(done, total) for what, done, total in reported if what == WHOLE]
    assert whole == [(k, 8) for k in range(1, 9)]
    assert ("paper leave one motion out", 2, 2) in reported


def test_rigid_commands_determine_six_of_the_papers_twelve_parameters(recordings):
    spectrum = identifiability(fit(reduce_recordings(recordings, 0.1, "velocity"), PAPER, CAD))
    assert spectrum.determined == 6
    assert spectrum.singular_values[5] > 5 * spectrum.singular_values[6]
    exact = make_setting("recommended", model="exact")
    wide = identifiability(fit(reduce_recordings(recordings, 0.1), exact, CAD))
    assert wide.determined == 7
    assert set(wide.unobservable) <= {f"{k}_w_{wheel}" for k in "xy" for wheel in ("FL", "BL", "BR", "FR")}


def test_a_motion_that_cannot_excite_a_parameter_leaves_it_unobservable():
    data = make_set(hidden_robot(3), 3, ["line_x"], 3)
    result = calibrate(data, RECOMMENDED, CLOCK)
    assert len(result.spectrum.unobservable) >= 4
    assert any("unobservable" in line for line in result.warnings)
    assert "leave_one_motion_out" not in result.validation


def test_one_recording_gives_no_interval_and_says_so():
    result = calibrate(make_set(hidden_robot(3), 3, ["line_x"], 1), RECOMMENDED, CLOCK)
    assert any("one recording only" in line for line in result.warnings)
    assert np.all(np.isnan(result.intervals.std))
    assert result.to_json()["std"]["r_m"] == [None] * 4


def test_twist_deployment_predicts_like_the_parameters():
    robot = hidden_robot(4)
    exact = make_setting("recommended", model="exact")
    result = calibrate(make_set(robot, 4), exact, CLOCK, validate=False)
    for run in make_set(robot, 200, OTHER_MOTIONS, 1, slip_share=0, run_to_run=0):
        by_twist = track(run, CAD, "exact", "position", result.twist)
        by_parameters = track(run, result.geometry, result.setting.model, "position")
        gap = np.hypot(*(by_twist.odometry - by_parameters.odometry)[:, :2].T)
        assert gap.max() < 1.5e-3


def test_nonsense_is_refused(recordings):
    with pytest.raises(UsageError, match="expected one of lm"):
        solve(Problem(reduce_recordings(recordings, 0.3), RECOMMENDED, CAD), "guess")
    with pytest.raises(DataError, match="no recordings"):
        calibrate([], RECOMMENDED, CLOCK)
    silent = [replace(recordings[0], wheel_rate_rad_s=np.full((len(recordings[0].t_s), 4), np.nan))]
    with pytest.raises(DataError, match="no wheel rates"):
        calibrate(silent, PAPER, CLOCK)


@pytest.mark.parametrize("seed", [2, pytest.param(4, marks=pytest.mark.long)])
def test_a_fit_ends_within_a_twentieth_of_a_standard_error_of_its_end(seed):
    blocks = reduce_recordings(make_set(hidden_robot(seed, contact="coulomb"), seed, repetitions=2), 0.3)
    found = fit(blocks, make_setting("recommended", model="dry-friction"), CAD)
    assert found.solution.converged
    _, _, hessian = found.problem.gradient_terms(found.solution.z)
    end = levenberg_marquardt(found.problem, found.solution.z, limit=500)
    moved = end.z - found.solution.z
    assert np.sqrt(moved @ hessian @ moved) < 0.05


def test_a_fit_that_did_not_end_is_no_secret(recordings, monkeypatch):
    monkeypatch.setattr("hil.calibration.fitting._NEAR", 0.0)
    monkeypatch.setattr(
        "hil.calibration.fitting.levenberg_marquardt",
        lambda p, z, limit=1: replace(levenberg_marquardt(p, z, 1), converged=False),
    )
    exact = make_setting("recommended", model="exact")
    found = calibrate(recordings, exact, CLOCK, validate=False)
    assert not found.to_json()["converged"]
    assert any("the fit ended before its parameters had settled" in line for line in found.warnings)
