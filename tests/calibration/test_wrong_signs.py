"""A wrong sign is refused by file and column; a fit that explains nothing says so."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.calibrate import calibrate
from hil.calibration.problem import RECOMMENDED
from hil.calibration.synthetic import MOTIONS, hidden_robot, make_set
from hil.cli import main
from hil.core.clock import MonotonicClock
from hil.core.errors import DataError
from hil.core.signals import WHEELS
from hil.datasets.nominal_robot import Nominal
from hil.datasets.plain_csv import write_plain
from hil.datasets.wrong_signs import check_signs, contradictions
from hil.robot.kinematics import WheelGeometry

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
    "x had": lambda one: mirrored(one, -1, 1, 1),
    "y had": lambda one: mirrored(one, 1, -1, 1),
    "x and y were exchanged": lambda one: replace(one, truth_pose=one.truth_pose[:, [1, 0, 2]]),
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
        check_signs(
            [one if one.name != "line_y_1" else CHANGES["steering (delta) had"](one) for one in good],
            Nominal(),
        )
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


@pytest.mark.parametrize("command", ["evaluate", "tune"])
def test_every_command_refuses_by_file(tmp_path, capsys, good, command):
    write_plain(tmp_path / "line_x_1.csv", CHANGES["wheel angles (phi) had"](good[0]))
    assert main([command, str(tmp_path / "line_x_1.csv")]) == 2
    assert "line_x_1.csv: the wheels contradict the ground truth" in capsys.readouterr().err


@pytest.mark.parametrize("words", CHANGES)
def test_a_circle_on_its_own_reports_every_sign(good, words):
    one = next(one for one in good if one.motion == "circle_cw")
    with pytest.raises(DataError, match=rf"^{one.name}: the wheels contradict .*{re.escape(words)}"):
        check_signs([CHANGES[words](one)], Nominal())


def exchanged(one, order):
    """A recording whose wheels stand in another order."""
    names = ("wheel_angle_rad", "steering_rad", "wheel_rate_rad_s")
    return replace(one, **{name: getattr(one, name)[:, order] for name in names})


def turned(one):
    """A recording whose ground truth has a heading that is a radian off."""
    return replace(one, truth_pose=one.truth_pose + np.array([0, 0, 1.0]))


def one_wheel_back(one):
    signs = np.array([-1, 1, 1, 1])
    return replace(
        one, wheel_angle_rad=one.wheel_angle_rad * signs, wheel_rate_rad_s=one.wheel_rate_rad_s * signs
    )


MIXED_UP = {
    "the FL and FR wheels are exchanged": lambda one: exchanged(one, [3, 1, 2, 0]),
    "the FL and BL wheels are exchanged": lambda one: exchanged(one, [1, 0, 2, 3]),
    "phi1 had the other sign": one_wheel_back,
    "delta1 had the other sign": lambda one: replace(one, steering_rad=one.steering_rad * (-1, 1, 1, 1)),
}


@pytest.mark.parametrize("said", MIXED_UP)
def test_a_wheel_that_alone_is_wrong_is_named(good, said):
    one = next(one for one in good if one.motion == "circle_cw")
    with pytest.raises(DataError, match=rf"^circle_cw_1: .*{said}"):
        check_signs([MIXED_UP[said](one)], Nominal())


def test_what_no_single_column_explains_is_named_with_the_recording_and_by_how_much(good):
    one = next(one for one in good if one.motion == "circle_cw")
    wrong = turned(one)
    check_signs([wrong], Nominal())
    (line,) = contradictions([wrong], CAD)
    assert re.match(rf"{one.name}: from second to second the wheels miss \d+ % of the way or turning", line)
    assert "look for wheels in another order" in line
    (line,) = contradictions([*good, *(replace(wrong, name=f"again_{k}") for k in range(6))], CAD)
    assert "(likewise, by less: again_1, again_2, again_3, again_4 and 1 more)" in line
    assert contradictions(good, CAD) == []


@pytest.mark.parametrize(
    ("contact", "spoilt"), [("viscous", "rotation_cw_1"), ("coulomb", "line_y_1"), ("elastic", "scan_1")]
)
def test_no_honest_recording_is_named(contact, spoilt):
    robot = hidden_robot(9, contact=contact)
    data = make_set(robot, 9, (*MOTIONS, "curl", "scan"), 1, corrupted=spoilt)
    check_signs(data, Nominal())
    (leaps,) = (one for one in data if one.contradictions)
    assert leaps.name == spoilt
    assert contradictions([one for one in data if one is not leaps], CAD) == []


def test_a_long_rest_does_not_count(good):
    """Ten minutes of noise before a drive are further than the drive."""
    one = good[0]
    rng, rest_s = np.random.default_rng(1), np.arange(0.0, 600.0, 0.02)
    noise = rng.normal(0.0, (1e-3, 1e-3, 5e-3), (len(rest_s), 3))
    still = np.repeat(one.wheel_angle_rad[:1], len(rest_s), axis=0)
    long = replace(
        one,
        t_s=np.concatenate([rest_s, one.t_s - one.t_s[0] + 600.0]),
        wheel_angle_rad=np.concatenate([still, one.wheel_angle_rad]),
        steering_rad=np.concatenate([np.repeat(one.steering_rad[:1], len(rest_s), axis=0), one.steering_rad]),
        wheel_rate_rad_s=np.concatenate([0.0 * still, one.wheel_rate_rad_s]),
        truth_t_s=np.concatenate([rest_s, one.truth_t_s - one.t_s[0] + 600.0]),
        truth_pose=np.concatenate([one.truth_pose[0] + noise, one.truth_pose]),
    )
    jitter = 1e-3 * np.random.default_rng(4).standard_normal(still.shape)
    rest = replace(
        long,
        t_s=rest_s,
        wheel_angle_rad=still + jitter,
        steering_rad=long.steering_rad[: len(rest_s)],
        wheel_rate_rad_s=0.0 * still,
        truth_t_s=rest_s,
        truth_pose=one.truth_pose[0] + noise,
    )
    assert contradictions([long, rest], CAD) == []


@pytest.mark.parametrize("command", ["evaluate", "replay", "tune"])
def test_figures_of_wheels_that_contradict_do_not_end_with_0(tmp_path, capsys, good, command):
    file = tmp_path / "circle_ccw_1.csv"
    one = next(one for one in good if one.motion == "circle_ccw")
    write_plain(file, turned(one))
    out = tmp_path / "tuned.toml"
    few = (
        ["--evaluations", "2", "--parameter", "wheels.step_m", "--out", str(out)] if command == "tune" else []
    )
    assert main([command, str(file), "--json", *few]) == 2
    assert not out.exists()
    reported = capsys.readouterr()
    found = json.loads(reported.out)
    (line,) = [w for w in found["problems"] if w.startswith("circle_ccw_1: ")]
    assert "wheels in another order" in line
    assert line in reported.err


def test_a_calibration_that_explains_nothing_is_not_written(tmp_path, capsys, good):
    """Exit code 1: a script takes 0 for a calibration that may be used."""
    out = tmp_path / "calibration.toml"
    files = [tmp_path / f"{one.name}.csv" for one in good]
    for file, one in zip(files, good, strict=True):
        write_plain(file, replace(one, truth_pose=one.truth_pose * [1.0, 1.0, 0.85]))
    assert main(["calibrate", *map(str, files), "--no-validation", "--json", "--out", str(out)]) == 1
    reported = capsys.readouterr()
    found = json.loads(reported.out)
    assert found["verdict"] == "FAIL"
    assert any("more than a workshop leaves" in line for line in found["warnings"])
    assert f"{out} is not written" in reported.err
    assert not out.exists()


def test_rates_against_the_angles_are_named(good):
    with pytest.raises(DataError, match=r"line_y_1: the wheel rates \(w\) have the other sign"):
        check_signs([replace(good[1], wheel_rate_rad_s=-good[1].wheel_rate_rad_s)], Nominal())


@pytest.mark.parametrize(
    ("scale", "contact"), [((0.3, 2.0), "viscous"), ((2.0, 0.3), "coulomb"), ((5.0, 5.0), "elastic")]
)
def test_no_robot_is_taken_for_one_with_a_wrong_sign(scale, contact):
    """Of any proportions, with the geometry of another robot in place of its own, and spoilt recordings."""
    robot = Nominal(WheelGeometry(scale[0] * CAD.x_m, scale[1] * CAD.y_m, scale[0] * CAD.radius_m))
    data = make_set(
        hidden_robot(5, contact=contact, nominal=robot), 5, (*MOTIONS, "curl", "scan"), 1, corrupted="curl_1"
    )
    check_signs(data, robot)
    check_signs(data, Nominal())


def test_a_fit_that_explains_something_says_no_such_thing(good):
    lines = calibrate(good, RECOMMENDED, MonotonicClock(), validate=False).warnings
    assert not any("explain the recordings" in line or "workshop" in line for line in lines)


@pytest.mark.parametrize("command", ["evaluate", "replay"])
def test_a_heading_that_is_off_is_named_with_the_angle(tmp_path, capsys, good, command):
    one = next(one for one in good if one.motion == "line_x")
    turned = replace(one, truth_pose=one.truth_pose + np.array([0.0, 0.0, 0.17]))
    lines = {}
    for name, recording in {"good": one, "turned": turned}.items():
        file = tmp_path / f"{name}_1.csv"
        write_plain(file, recording)
        assert main([command, str(file), "--json"]) == 0
        lines[name] = [w for w in json.loads(capsys.readouterr().out)["warnings"] if "steering zeros" in w]
    assert lines["good"] == []
    assert re.search(r"0\.1[5-9]\d rad", lines["turned"][0])


@pytest.mark.parametrize("command", ["calibrate", "evaluate", "tune"])
def test_recordings_in_which_no_wheel_turns_give_no_figures(tmp_path, capsys, good, command):
    file, out = tmp_path / "line_x_1.csv", tmp_path / "out.toml"
    write_plain(file, at_rest(good[0]))
    more = {
        "evaluate": [],
        "tune": ["--evaluations", "2", "--out", str(out)],
        "calibrate": ["--out", str(out)],
    }
    assert main([command, str(file), *more[command]]) == 2
    assert "line_x_1" in (said := capsys.readouterr().err)
    assert "no wheel turns" in said
    assert not out.exists()


def test_a_recording_at_rest_among_others_is_left_out(good):
    found = calibrate(
        [*good, replace(at_rest(good[0]), name="line_x_2")], RECOMMENDED, MonotonicClock(), validate=False
    )
    assert list(found.rejected) == ["line_x_2"]
    assert found.explains


def test_a_calibration_of_contradicted_recordings_explains_nothing(good):
    """Places of the ground truth in a frame that is turned by 30 degrees, headings not."""
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    wrong = [replace(one, truth_pose=one.truth_pose @ turn.T) for one in good]
    assert not calibrate(wrong, RECOMMENDED, MonotonicClock(), validate=False).explains


def at_rest(one):
    still = {name: 0.0 * getattr(one, name) for name in ("wheel_angle_rad", "wheel_rate_rad_s", "truth_pose")}
    return replace(one, **still)


@pytest.mark.parametrize("order", [(0, 3, 1, 2), (1, 0, 3, 2), (2, 3, 0, 1), (3, 2, 1, 0)])
def test_another_order_of_the_wheels_is_named(order):
    """FL, FR, BL, BR is that of most robots; with front and back exchanged only turns differ."""
    good = make_set(hidden_robot(4), 4, ("line_x", "line_y", "circle_ccw", "rotation_cw", "arc"), 1)
    columns = list(order)
    spoilt = [
        replace(
            one,
            wheel_angle_rad=one.wheel_angle_rad[:, columns],
            steering_rad=one.steering_rad[:, columns],
            wheel_rate_rad_s=one.wheel_rate_rad_s[:, columns],
        )
        for one in good
    ]
    with pytest.raises(DataError, match="held the wheels " + ", ".join(WHEELS[i] for i in order)):
        check_signs(spoilt, Nominal())
