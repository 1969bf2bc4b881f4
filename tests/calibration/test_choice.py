"""The forward model is chosen by recordings that the fit did not see, and the choice says how clear it is."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration import calibrate as calibrate_module
from hil.calibration import model_choice as choice_module
from hil.calibration.calibrate import calibrate
from hil.calibration.calibration_file import calibration_file
from hil.calibration.cross_validation import table_of
from hil.calibration.model_choice import Candidate, Choice, apart_m, candidates, choose, probabilities
from hil.calibration.problem import make_setting
from hil.calibration.synthetic import _springs, hidden_robot, make_set
from hil.core.clock import MonotonicClock
from hil.core.errors import DataError
from hil.datasets.nominal_robot import Nominal
from hil.robot.contact_laws import creep_motion
from hil.robot.kinematics import WheelGeometry, projection, wheel_vectors

SETTING = make_setting("recommended")
BRIEF = ("line_x", "line_y", "circle_ccw")


def found(contact, seed=3):
    robot = hidden_robot(seed, contact=contact)
    recordings = make_set(robot, seed, BRIEF, repetitions=4, run_to_run=0.2, slip_share=0.0)
    return choose(recordings, candidates(SETTING, robot.nominal.geometry))


def test_dry_contact_is_read_by_the_model_of_dry_friction():
    choice = found("coulomb")
    assert choice.best.setting.model == "dry-friction", choice.held_out_m
    assert choice.held_out_m["dry friction"] < 0.8 * choice.held_out_m["exact"]


def loaded_robot(load):
    """A robot on dry contact whose wheels are off its drawing and bear these loads, as its drawing says."""
    drawn = hidden_robot(4, contact="coulomb")
    return replace(drawn, load=load, nominal=Nominal(WheelGeometry.nominal().with_tyres(load, 1.0)))


def test_dry_friction_weighs_wheels_by_their_loads_where_that_reads_left_out_recordings():
    """Motion was made with loads of 0.5 to 1.5: with them known it comes back, with equal ones not."""
    robot = loaded_robot(np.array([0.5, 1.4, 1.5, 0.6]))
    recordings = make_set(robot, 4, BRIEF, repetitions=2, run_to_run=0.0, slip_share=0.0)
    choice = choose(recordings, candidates(SETTING, robot.nominal.geometry))
    assert choice.best.name == "dry friction, loads by statics", choice.held_out_m
    assert np.array_equal(choice.best.nominal.load, robot.load)
    assert choice.held_out_m[choice.best.name] < 0.6 * choice.held_out_m["dry friction"]


def test_loads_of_dry_friction_go_with_the_calibration():
    robot = loaded_robot(np.array([0.5, 1.4, 1.5, 0.6]))
    recordings = make_set(robot, 4, BRIEF[:1], repetitions=1)
    asked = make_setting("recommended", model="dry-friction")
    result = calibrate(recordings, asked, MonotonicClock(), nominal=robot.nominal, validate=False)
    file = calibration_file(result, created="2026-01-01", software={})
    assert np.array_equal(file.geometry.load, robot.load)
    old = file.model_copy(update={"tyres": None})
    assert np.array_equal(old.geometry.load, np.ones(4)), "files without loads weigh wheels alike"


def test_where_contact_is_viscous_dry_friction_is_not_taken():
    assert found("viscous").best.setting.model != "dry-friction"


def test_what_belongs_together_is_left_out_together(monkeypatch):
    """Repetitions of one round are alike: a model that reads these need not read the next round."""
    robot, seen = hidden_robot(1), []
    recordings = make_set(robot, 1, BRIEF[:1], repetitions=4)

    def judged(recordings, groups, candidate):
        seen.append(list(groups))
        return recordings

    monkeypatch.setattr(choice_module, "_left_out", judged)
    monkeypatch.setattr(choice_module, "_at_wheels_m", lambda run, nominal: 1.0)
    among = candidates(SETTING, robot.nominal.geometry)[:2]
    for groups in ((), (0, 0, 0, 0), (0, 0, 1, 1)):
        choose(recordings, among, groups=groups)
    assert [len(set(groups)) for groups in seen[::2]] == [4, 4, 2]
    assert seen[-1] == [0, 0, 1, 1]


def test_hil_calibrate_lets_held_out_recordings_decide_and_says_so(monkeypatch):
    """What the choice has left out of a fit is not left out of the same fit once more."""
    robot = hidden_robot(3, contact="coulomb")
    recordings = make_set(robot, 3, ("circle_ccw",), repetitions=2, run_to_run=0.2, slip_share=0.0)
    left_out, fitted = calibrate_module.left_out, []
    monkeypatch.setattr(
        calibrate_module, "left_out", lambda *given: fitted.append(given[2].model) or left_out(*given)
    )
    result = calibrate(recordings, make_setting("recommended"), MonotonicClock())
    assert fitted == ["paper"]
    fit = result.fit
    again = left_out(recordings, fit.problem.blocks, result.setting, result.nominal, fit.solution.z, [0, 1])
    assert result.validation["leave_one_repetition_out"] == table_of(again)
    reported = result.to_json()["forward_models"]
    assert reported["best"] == result.choice.best.name
    assert result.choice.best.setting.model == result.setting.model
    asked = make_setting("recommended", model="exact")
    assert calibrate(recordings, asked, MonotonicClock()).choice is None


def test_models_that_may_be_as_right_are_in_the_intervals():
    robot = hidden_robot(3)
    recordings = make_set(robot, 3, ("line_x", "circle_ccw"), repetitions=2, run_to_run=0.2, slip_share=0.0)
    plain, creep = (make_setting("recommended", model=m) for m in ("exact", "creep"))
    best, rival = (Candidate(s.model, s, WheelGeometry.nominal()) for s in (plain, creep))
    shares = {"exact": 0.6, "creep": 0.2}
    alone, beside = (
        calibrate(
            recordings,
            plain,
            MonotonicClock(),
            choice=Choice(best, {}, 0.6, rivals, shares=shares),
            validate=False,
        )
        for rivals in ((), (rival,))
    )
    other = calibrate(recordings, creep, MonotonicClock(), validate=False)
    apart = alone.fit.solution.z - other.fit.solution.z
    wanted = 0.75 * alone.intervals.covariance + 0.25 * (other.intervals.covariance + np.outer(apart, apart))
    np.testing.assert_allclose(beside.intervals.covariance, wanted, rtol=1e-9, atol=1e-18)


def test_springs_that_roll_on_come_to_creep():
    robot = hidden_robot(1, contact="elastic")
    u = np.tile(wheel_vectors(np.full((1, 4), 4e-4), np.array([[0.02, -0.01, 0.03, 0.0]])), (400, 1))
    p = projection(robot.geometry.x_m, robot.geometry.y_m)
    body, creeping = _springs(robot, p, u), creep_motion(p, u, robot.load, robot.ratio)
    assert np.allclose(body[-1], creeping[-1], atol=1e-12)
    turned = wheel_vectors(np.full((1, 4), 4e-4), np.array([[1.2, 1.25, 1.22, 1.2]]))
    after = _springs(robot, p, np.vstack([u, turned]))[-1]
    assert not np.allclose(after, creep_motion(p, turned, robot.load, robot.ratio)[0], atol=1e-6)


def test_without_a_repetition_to_leave_out_nothing_is_chosen():
    robot = hidden_robot(1)
    recordings = make_set(robot, 1, BRIEF, repetitions=1)
    with pytest.raises(DataError, match="at least two"):
        choose(recordings, candidates(SETTING, robot.nominal.geometry))


def test_what_models_are_apart_on_motions_of_a_metre():
    robot = hidden_robot(3)
    recordings = make_set(robot, 3, BRIEF, repetitions=1, run_to_run=0.0, slip_share=0.0)
    setting = make_setting("recommended", model="exact")
    result = calibrate(recordings, setting, MonotonicClock(), nominal=robot.nominal, validate=False)
    fit, z = result.fit, result.fit.solution.z
    larger = z.copy()
    larger[8:12] *= 1.01
    other = replace(fit, solution=replace(fit.solution, z=larger))
    assert set(apart_m(fit, [fit], result.nominal).values()) == {0.0}
    apart = apart_m(fit, [fit, other], result.nominal)
    assert [apart["forwards"], apart["sideways"]] == pytest.approx([0.01, 0.01], rel=0.1)


def test_models_that_are_as_right_are_named_with_what_that_costs_elsewhere():
    """Lines alone leave open how wheels resist a diagonal motion."""
    robot = hidden_robot(3)
    recordings = make_set(robot, 3, ("line_x", "line_y"), repetitions=2, run_to_run=0.2, slip_share=0.0)
    result = calibrate(recordings, SETTING, MonotonicClock(), nominal=robot.nominal)
    assert result.choice.rivals
    assert max(result.apart_m.values()) > 0.001
    reported = result.to_json()["forward_models"]
    assert reported["apart_m"] == dict(result.apart_m)
    said = " ".join(result.choice_in_words())
    assert all(rival.name in said for rival in result.choice.rivals)


def of(law, ratio=1.0, loads=(1.0, 1.0, 1.0, 1.0)):
    setting = make_setting("recommended", model=law)
    return Candidate(f"{law} {ratio} {loads}", setting, WheelGeometry.nominal().with_tyres(loads, ratio))


FOUR = [of("exact"), of("dry-friction"), of("creep"), of("creep", 0.4)]


def test_before_any_data_a_law_is_as_probable_as_another_and_dry_friction_half():
    assert probabilities(FOUR, [[0.003]] * 4, ["a"]) == pytest.approx([2 / 7, 1 / 7, 2 / 7, 2 / 7])
    loads = (0.5, 1.5, 0.5, 1.5)
    also = [*FOUR, of("dry-friction", loads=loads), of("creep", loads=loads)]
    found = probabilities(also, [[0.003]] * 6, ["a"])
    assert found == pytest.approx([2 / 7, 1 / 14, 1 / 7, 2 / 7, 1 / 14, 1 / 7])


def test_probabilities_grow_with_the_recordings_and_not_with_copies_of_one():
    errors = [[0.005] * 24, [0.004] * 24, [0.005] * 24, [0.005] * 24]
    few = probabilities(FOUR, [own[:4] for own in errors], range(4))[1]
    many = probabilities(FOUR, errors, range(24))[1]
    assert few < 0.5
    assert many > 0.95
    assert probabilities(FOUR, errors, [k % 4 for k in range(24)])[1] == pytest.approx(few)


def test_a_recording_in_which_the_robot_slid_decides_no_more_than_others():
    """A burst of slip that every law misses leaves the choice to the recordings without one."""
    calm = [[0.004] * 6, [0.004] * 6, [0.001] * 6, [0.004] * 6]
    slid = [[*own, burst] for own, burst in zip(calm, (0.050, 0.060, 0.054, 0.060), strict=True)]
    assert probabilities(FOUR, slid, range(7)) == pytest.approx(probabilities(FOUR, calm, range(6)), abs=0.02)


@pytest.mark.parametrize(
    ("errors", "chosen"),
    [
        ((0.0040, 0.0036, 0.0040, 0.0060), "exact"),
        ((0.0060, 0.0036, 0.0040, 0.0060), "creep"),
        ((0.0060, 0.0020, 0.0060, 0.0060), "dry-friction"),
        ((0.0040, 0.0060, 0.0020, 0.0060), "creep"),
    ],
)
def test_without_a_clear_choice_the_simplest_of_the_probable_laws_is_taken(monkeypatch, errors, chosen):
    robot = hidden_robot(1)
    recordings = make_set(robot, 1, BRIEF[:2], repetitions=3)
    of_candidate = iter(errors)
    monkeypatch.setattr(
        choice_module, "left_out", lambda recordings, *given: [next(of_candidate)] * len(recordings)
    )
    monkeypatch.setattr(choice_module, "_at_wheels_m", lambda error, nominal: error)
    choice = choose(recordings, FOUR)
    assert choice.best.law == chosen
    clear = chosen in ("dry-friction", "creep") and min(errors) == 0.0020
    assert (choice.confidence > 0.9) == clear
    assert ("no clear choice" not in choice.in_words()) == clear
