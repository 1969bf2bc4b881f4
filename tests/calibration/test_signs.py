"""A wrong sign is refused by file and column; a fit that explains nothing says so."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.calibrate import calibrate
from hil.calibration.nominal import Nominal
from hil.calibration.problem import RECOMMENDED
from hil.calibration.signs import check_signs
from hil.calibration.synthetic import MOTIONS, hidden_robot, make_set
from hil.cli import main
from hil.recording.plain_csv import write_plain
from hil.recording.sources import read_recordings
from hil.robot.kinematics import WheelGeometry
from hil.vocabulary.clock import MonotonicClock
from hil.vocabulary.errors import DataError

CAD = WheelGeometry.nominal()


@pytest.fixture(scope="module")
def good():
    return make_set(hidden_robot(3), 3, repetitions=1)


def mirrored(one, *signs):
    return replace(one, truth_pose=one.truth_pose * signs)


CHANGES = {
    "wheel angles (phi) had": lambda one: replace(one, wheel_angle_rad=-one.wheel_angle_rad),
    "steering (delta) had": lambda one: replace(one, steering_rad=-one.steering_rad),
    "the heading (theta) had": lambda one: mirrored(one, 1, 1, -1),
    "y and the heading (theta) had": lambda one: mirrored(one, 1, -1, -1),
    "half a turn": lambda one: replace(one, truth_pose=one.truth_pose + np.array([0, 0, np.pi])),
}


@pytest.mark.parametrize("words", CHANGES)
def test_of_a_whole_set_the_one_column_is_named(good, words):
    check_signs(good, Nominal())
    with pytest.raises(DataError) as error:
        check_signs([CHANGES[words](one) for one in good], Nominal())
    assert words in str(error.value)
    assert ", or if" not in str(error.value)
    assert "more recordings likewise" in str(error.value)
    if words == "wheel angles (phi) had":
        assert f" ({len(good) - 1} more recordings likewise)" in str(error.value)


def test_of_one_motion_all_that_it_may_be_is_named(good):
    with pytest.raises(DataError, match=r"^line_y_1: .*\(phi\).*, or if .*\(delta\)") as error:
        check_signs([one if one.name != "line_y_1" else CHANGES["steering (delta) had"](one) for one in good],
                    Nominal())  # fmt: skip
    assert "likewise" not in str(error.value)


def beginning(one, seconds):
    """The first part of a recording."""
    rows = one.t_s <= one.t_s[0] + seconds
    names = ("t_s", "wheel_angle_rad", "steering_rad", "wheel_rate_rad_s")
    cut = {name: getattr(one, name)[rows] for name in names}
    rows = one.truth_t_s <= one.truth_t_s[0] + seconds
    return replace(one, **cut, truth_t_s=one.truth_t_s[rows], truth_pose=one.truth_pose[rows])


@pytest.mark.parametrize("seconds", [4.0, 1000.0])
@pytest.mark.parametrize("number", range(len(MOTIONS)))
def test_a_single_drive_is_enough_however_short_or_of_turns_only(good, number, seconds):
    one = beginning(good[number], seconds)
    check_signs([one], Nominal())
    with pytest.raises(DataError, match=rf"^{one.name}: .*wheel angles \(phi\) had the other sign"):
        check_signs([CHANGES["wheel angles (phi) had"](one)], Nominal())


@pytest.mark.parametrize("command", ["evaluate", "calibrate", "tune"])
def test_every_command_refuses_by_file(tmp_path, capsys, good, command):
    write_plain(tmp_path / "line_x_1.csv", CHANGES["wheel angles (phi) had"](good[0]))
    assert main([command, str(tmp_path / "line_x_1.csv")]) == 2
    told = capsys.readouterr().err
    assert "line_x_1.csv: the wheels contradict the ground truth" in told
    assert "wheel angles (phi)" in told


def test_rates_against_the_angles_are_named(good):
    with pytest.raises(DataError, match=r"line_y_1: the wheel rates \(w\) have the other sign"):
        check_signs([replace(good[1], wheel_rate_rad_s=-good[1].wheel_rate_rad_s)], Nominal())


@pytest.mark.parametrize("scale", [(0.3, 2.0), (2.0, 0.3), (5.0, 5.0)])
@pytest.mark.parametrize("contact", ["viscous", "coulomb", "elastic"])
def test_no_robot_is_taken_for_one_with_a_wrong_sign(scale, contact):
    """Of any proportions, with the geometry of another robot in place of its own, and spoilt recordings."""
    robot = Nominal(WheelGeometry(scale[0] * CAD.x_m, scale[1] * CAD.y_m, scale[0] * CAD.radius_m))
    data = make_set(
        hidden_robot(5, contact=contact, nominal=robot), 5, (*MOTIONS, "curl", "scan"), 1, corrupted="curl_1"
    )
    check_signs(data, robot)
    check_signs(data, Nominal())


def test_the_real_recordings_have_no_wrong_sign(public_data):
    check_signs(read_recordings([public_data]), Nominal())


def test_a_fit_that_explains_nothing_says_so(good):
    turned = [CHANGES["wheel angles (phi) had"](one) for one in good]
    lines = calibrate(turned, RECOMMENDED, MonotonicClock(), validate=False).warnings
    assert any("does not explain the recordings" in line and "do not use it" in line for line in lines)
    assert any("more than a workshop leaves" in line for line in lines)
    lines = calibrate(good, RECOMMENDED, MonotonicClock(), validate=False).warnings
    assert not any("explain the recordings" in line or "workshop" in line for line in lines)
