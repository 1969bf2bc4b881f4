"""Sets with one injected fault: each is refused with its cause, or the figure is right."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.calibration.calibrate import calibrate
from hil.calibration.cross_validation import unlike_repetitions
from hil.calibration.evaluation import position_rmse, track, track_all
from hil.calibration.problem import RECOMMENDED
from hil.calibration.synthetic import MOTIONS, OTHER_MOTIONS, hidden_robot, make_set
from hil.cli import main
from hil.core.clock import MonotonicClock
from hil.core.errors import DataError
from hil.datasets.cleaning import Log
from hil.datasets.plain_csv import write_plain
from hil.datasets.read import read_recordings
from hil.datasets.truth_correction import corrected, notes_of
from hil.datasets.wheel_log import build_recording
from hil.robot.kinematics import WheelGeometry
from tests.calibration.spoilt_sets import make_drives


@pytest.fixture(scope="module")
def healthy():
    return make_set(hidden_robot(4), 4, (*MOTIONS, "arc"), 2)


def second(one):
    return one.name.endswith("_2")


def turned(by_rad):
    """The body of the second repetitions was set anew, with another heading."""
    return lambda one: (
        replace(one, truth_pose=one.truth_pose + np.array([0.0, 0.0, by_rad])) if second(one) else one
    )


def off_centre(by_m):
    """The body of the second repetitions was set anew, with another middle."""

    def spoil(one):
        pose = one.truth_pose.copy()
        pose[:, :2] += by_m * np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
        return replace(one, truth_pose=pose) if second(one) else one

    return spoil


def wheel_late(wheel, by_s):
    """The columns of one wheel come from a slower bus."""

    def spoil(one):
        angle, steering = one.wheel_angle_rad.copy(), one.steering_rad.copy()
        for columns in (angle, steering):
            columns[:, wheel] = np.interp(one.t_s - by_s, one.t_s, columns[:, wheel])
        return replace(one, wheel_angle_rad=angle, steering_rad=steering)

    return spoil


def averaged(over_s):
    """Each pose is the mean of those over so many seconds about it."""

    def spoil(one):
        rows = round(over_s / float(np.median(np.diff(one.truth_t_s)))) // 2 * 2 + 1
        padded = np.pad(one.truth_pose, ((rows // 2, rows // 2), (0, 0)), mode="edge")
        sums = np.cumsum(np.vstack([np.zeros(3), padded]), axis=0)
        return replace(one, truth_pose=(sums[rows:] - sums[:-rows]) / rows)

    return spoil


def heading_times(factor):
    """The heading has another scale."""
    return lambda one: replace(one, truth_pose=one.truth_pose * (1.0, 1.0, factor))


ALL = {f"{motion}_{k}" for motion in (*MOTIONS, "arc") for k in (1, 2)}
SHOWN = {name for name in ALL if not name.startswith("rotation")}
"""Recordings whose heading matters, of both sessions: turns on the spot go nowhere."""


@pytest.mark.parametrize(
    ("spoil", "cause", "named"),
    [
        (
            turned(0.02),
            "the heading of its ground truth, or all its steering angles, are 0.02 rad off",
            SHOWN,
        ),
        (
            turned(0.05),
            "the heading of its ground truth, or all its steering angles, are 0.05 rad off",
            SHOWN,
        ),
        (
            turned(-0.2),
            "the heading of its ground truth, or all its steering angles, are 0.20 rad off",
            SHOWN,
        ),
        (off_centre(0.03), "tracks a point 30 mm from", {"rotation_ccw_2", "rotation_cw_2"}),
        (wheel_late(0, 0.3), "columns of the FL wheel", ALL),
        (wheel_late(2, -0.3), "columns of the BR wheel", ALL),
        (averaged(1.0), "smoother than the motion of the wheels", ALL),
        (averaged(0.3), "", set()),
        (heading_times(1.1), "turns 1.10", ALL),
        (heading_times(1.04), "turns 1.04", ALL),
        (heading_times(0.95), "turns 0.95", ALL),
        (heading_times(1.01), "turns 1.01", ALL),
    ],
    ids=[
        *("turned 0.02", "turned 0.05", "turned -0.2", "off centre", "FL late", "BR early", "1 s", "0.3 s"),
        *("theta 1.1", "theta 1.04", "theta 0.95", "theta 1.01"),
    ],
)
def test_a_fault_is_refused_with_its_cause_or_the_figure_is_right(healthy, spoil, cause, named):
    """Of two repetitions with other headings neither is known to be right."""
    found = {one.name: one.contradictions for one in corrected([spoil(one) for one in healthy])}
    refused = {name for name, said in found.items() if said}
    assert refused == named
    assert all(cause in found[name][0] for name in refused)


def test_a_wheel_whose_columns_are_late_ends_evaluate_with_2(healthy, tmp_path, capsys):
    for one in healthy:
        write_plain(tmp_path / f"{one.name}.csv", wheel_late(0, 0.3)(one))
    assert main(["evaluate", str(tmp_path)]) == 2
    assert main(["calibrate", str(tmp_path), "--no-validation", "--out", str(tmp_path / "c.toml")]) == 2
    assert "FL wheel" in capsys.readouterr().err
    assert not (tmp_path / "c.toml").exists()


@pytest.mark.parametrize("seed", [7, 8, 28, 29])
def test_bursts_of_slip_are_no_fault_of_the_ground_truth(seed):
    """Each of these sets had a line with bursts, whose distances, heading or drift seemed to be another's."""
    contact = ("viscous", "coulomb", "creep", "elastic")[seed % 4]
    motions = (*MOTIONS, *OTHER_MOTIONS)[: 6 + seed % 5]
    share = (0.0, 0.25, 0.5)[seed % 3]
    found = corrected(make_set(hidden_robot(seed, contact=contact), seed, motions, 2, slip_share=share))
    assert [one.name for one in found if one.contradictions] == []


def filled(one, period_s):
    """Poses of a slow source, filled up to the rate of the file along straight lines."""
    at_s = np.arange(one.truth_t_s[0], one.truth_t_s[-1], period_s)
    columns = [np.interp(one.truth_t_s, at_s, np.interp(at_s, one.truth_t_s, c)) for c in one.truth_pose.T]
    wheels = np.column_stack([one.wheel_angle_rad, one.steering_rad])
    truth = Log(one.truth_t_s, np.column_stack(columns))
    return build_recording(one.name, Log(one.t_s, wheels), truth, motion=one.motion)


@pytest.mark.parametrize("period_s", [0.2, 0.5])
def test_poses_filled_in_are_left_out_and_counted_and_the_figure_stays(healthy, period_s):
    found = corrected(spoilt := [filled(one, period_s) for one in healthy])
    assert all(any(f"poses {period_s:g} s apart" in what for what in one.repairs) for one in spoilt)
    assert notes_of(found) == []
    assert not any(one.contradictions for one in found)
    errors = [
        [position_rmse(track(one, WheelGeometry.nominal())) for one in some] for some in (found, healthy)
    ]
    np.testing.assert_allclose(*errors, rtol=0.1, atol=3e-4)


def test_measured_poses_are_not_taken_for_filled_in(healthy):
    assert not any("filled" in what for one in healthy for what in one.repairs)


def exchanged(one, pose, steering):
    """The heading is written as delta1, and the other way round."""
    heading = pose[:, 2].copy()
    pose[:, 2] = np.interp(one.truth_t_s, one.t_s, steering[:, 0])
    steering[:, 0] = np.interp(one.t_s, one.truth_t_s, heading)


def height(one, pose, steering):
    pose[:, 1] = 0.08 + np.random.default_rng(1).normal(0.0, 2e-4, len(pose))


def course(one, pose, steering):
    step = pose[20:, :2] - pose[:-20, :2]
    goes = np.flatnonzero(np.hypot(*step.T) > 2e-3)
    angle = np.unwrap(np.arctan2(step[goes, 1], step[goes, 0]))
    pose[:, 2] = np.interp(np.arange(len(pose)), goes + 20, angle)


@pytest.mark.parametrize(
    ("spoil", "motions", "named"),
    [
        (
            exchanged,
            ("line_y", "circle_ccw", "rotation_cw", "arc"),
            r"heading \(theta\) and delta1 are exchanged",
        ),
        (height, ("line_y", "circle_ccw"), "y does not follow the robot"),
        (course, ("line_y",), r"heading \(theta\) is the direction in which it moves"),
    ],
)
def test_a_column_that_holds_another_quantity_is_named(healthy, spoil, motions, named):
    """Where the motion shows it; the others have units that would explain nothing."""
    for one in (one for one in healthy if one.motion in motions):
        pose, steering = one.truth_pose.copy(), one.steering_rad.copy()
        spoil(one, pose, steering)
        wheels = Log(one.t_s, np.column_stack([one.wheel_angle_rad, steering]))
        with pytest.raises(DataError, match=named):
            build_recording(one.name, wheels, Log(one.truth_t_s, pose), motion=one.motion)


PAIRS = make_drives(323)
"""Eight good recordings of four motions; those of the turn on the spot are both ccw."""


def stuck(one):
    """The second wheel's angle leaps in the middle of the drive."""
    angle = one.angle.copy()
    angle[len(angle) // 2 :, 1] += 40.0
    return replace(one, angle=angle)


def moved(one):
    """The body of the ground truth is 0.3 m off."""
    c, s = np.cos(one.truth[:, 2]), np.sin(one.truth[:, 2])
    return replace(one, truth=one.truth + 0.3 * np.column_stack([c, s, 0.0 * c]))


def leaps(one):
    truth = one.truth.copy()
    truth[len(truth) // 2 :, :2] += 0.2
    return replace(one, truth=truth)


@pytest.mark.parametrize(
    ("spoilt", "code"),
    [
        ({"rotation_ccw_1": stuck, "rotation_ccw_2": stuck}, 2),
        ({"rotation_ccw_1": stuck, "rotation_ccw_2": leaps}, 2),
        ({"rotation_ccw_1": moved, "rotation_ccw_2": moved}, 2),
        ({"diagonal_1": stuck, "line_y_1": stuck, "curl_1": stuck}, 2),
        ({"diagonal_1": stuck, "line_y_1": leaps, "curl_1": leaps, "rotation_ccw_1": leaps}, 2),
        ({"diagonal_1": stuck, "line_y_1": leaps, "curl_1": leaps}, 0),
        ({"diagonal_1": stuck, "curl_1": stuck}, 0),
        ({}, 0),
    ],
)
def test_a_set_that_loses_a_motion_half_or_much_for_one_reason_is_refused(tmp_path, capsys, spoilt, code):
    """What all checks leave out adds up; the exit code, the verdict and the file agree."""
    folder, out = tmp_path / "set", tmp_path / "c.toml"
    folder.mkdir()
    for one in PAIRS:
        spoilt.get(one.name, lambda same: same)(one).write(folder)
    words = ["calibrate", str(folder), "--model", "exact", "--no-validation", "--out", str(out), "--json"]
    capsys.readouterr()
    assert main(words) == code
    found = json.loads(capsys.readouterr().out)
    assert out.exists() == (code == 0)
    if code:
        assert all(name in found["error"]["message"] for name in spoilt)
    else:
        assert found["verdict"] == "PASS"
        assert {Path(name).stem for name in found["rejected"]} == set(spoilt)


def test_a_motion_whose_only_recording_is_left_out_stands_beside_the_errors(tmp_path):
    for one in (stuck(d) if d.name == "curl_1" else d for d in PAIRS if d.name != "curl_2"):
        one.write(tmp_path)
    unusable = {}
    found = read_recordings([tmp_path], unusable=unusable)
    made = replace(RECOMMENDED, model="exact", choose_model=False)
    result = calibrate(found, made, MonotonicClock(), validate=False, unusable=unusable)
    compared = result.to_json()["compared_with_nominal"]
    assert compared["lacking"] == ["curl"]
    assert set(compared["motions"]) == {"diagonal", "line_y", "rotation_ccw"}
    assert "not of curl" in result.compared.in_words()


@pytest.mark.parametrize("axis", [0, 1])
def test_repetitions_that_do_not_agree_are_named(healthy, axis):
    """One drive's positions are 4 % too long along an axis; slip and tolerances name none."""
    one = next(one for one in healthy if one.name == ("line_x_1", "line_y_1")[axis])
    factor = np.where(np.arange(3) == axis, 1.04, 1.0)
    spoilt = [replace(r, truth_pose=r.truth_pose * factor) if r is one else r for r in healthy]
    lines = [unlike_repetitions(track_all(some, WheelGeometry.nominal()), 0.16) for some in (healthy, spoilt)]
    assert lines[0] == []
    (line,) = lines[1]
    assert line.startswith(f"{one.motion}_1, {one.motion}_2: ")


@pytest.mark.parametrize("seed", [7, 8, 28, 29])
def test_slip_is_no_disagreement_of_repetitions(seed):
    found = make_set(hidden_robot(seed), seed, (*MOTIONS, *OTHER_MOTIONS)[: 6 + seed % 5], 2, slip_share=0.5)
    assert unlike_repetitions(track_all(found, WheelGeometry.nominal()), 0.16) == []
