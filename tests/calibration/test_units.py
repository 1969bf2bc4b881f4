"""Recordings in other units than seconds, metres and radians are refused by every command."""

import numpy as np
import pytest

from hil.calibration.datasets import Log, build_recording
from hil.calibration.synthetic import hidden_robot, simulate
from hil.cli import main
from hil.recording.plain_csv import write_plain
from hil.vocabulary.errors import DataError

DEG = 180.0 / np.pi


def logs(motion):
    run = simulate(hidden_robot(1), motion, f"{motion}_1", np.random.default_rng(1))
    return run.t_s, np.column_stack([run.wheel_angle_rad, run.steering_rad]), run.truth_t_s, run.truth_pose


@pytest.fixture(scope="module")
def circle():
    return logs("circle_ccw")


@pytest.fixture(scope="module")
def turn():
    return logs("rotation_cw")


@pytest.mark.parametrize(
    ("factor", "begin", "said"),
    [
        (1e3, 0.0, "16 from row .*expected seconds.* 1e3 if it is in milliseconds"),
        (1e6, 0.0, "1.6e[+]04 .* 1e6 if it is in microseconds"),
        (1e9, 0.0, "1.6e[+]07 .* 1e9 if it is in nanoseconds"),
        (1e9, 1.7e9, "1.6e[+]07 .* 1e9 if it is in nanoseconds"),
    ],
)
def test_times_that_are_not_seconds_are_named_with_their_step(turn, factor, begin, said):
    t_s, wheels, truth_t_s, pose = turn
    with pytest.raises(DataError, match=rf"^turn\.csv: time \(t\) goes on by {said}"):
        build_recording(
            "turn", Log((begin + t_s) * factor, wheels), Log((begin + truth_t_s) * factor, pose),
            sources=("turn.csv",),
        )  # fmt: skip


def test_stamps_that_repeat_or_are_no_numbers_do_not_make_other_units(turn):
    t_s, wheels, truth_t_s, pose = turn
    t_s = t_s.copy()
    t_s[100:110], t_s[200], t_s[300] = t_s[100], np.nan, 1e300
    found = build_recording("turn", Log(t_s, wheels), Log(truth_t_s, pose))
    assert found.repairs["wheel rows without numbers dropped"] == 2


def test_one_stamp_that_is_far_from_all_others_is_named(turn):
    t_s, wheels, truth_t_s, pose = turn
    with pytest.raises(DataError, match=r"time .t. leaps by 1e\+09 s .*rows whose stamps are damaged"):
        build_recording("turn", Log(np.append(t_s[:-1], 1e9), wheels), Log(truth_t_s, pose))


@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize("which", ["circle", "turn"])
def test_a_heading_in_degrees_is_named(which, wrapped, request):
    t_s, wheels, truth_t_s, pose = request.getfixturevalue(which)
    heading = np.angle(np.exp(1j * pose[:, 2])) if wrapped else pose[:, 2]
    with pytest.raises(DataError, match=r"the heading \(theta\) turns by 3.. while.*expected radians"):
        build_recording("run", Log(t_s, wheels), Log(truth_t_s, np.c_[pose[:, :2], DEG * heading]))


def test_a_heading_in_radians_may_leap_at_half_a_turn_and_hold_damaged_rows(circle):
    t_s, wheels, truth_t_s, pose = circle
    heading = np.angle(np.exp(1j * (pose[:, 2] + 3.0)))
    heading[[5, 500]] = 9999.0
    build_recording("run", Log(t_s, wheels), Log(truth_t_s, np.c_[pose[:, :2], heading]))


@pytest.mark.parametrize("factor", [DEG, 25.4])
@pytest.mark.parametrize("which", ["circle", "turn"])
def test_wheel_angles_in_degrees_or_millimetres_are_named(which, factor, request):
    t_s, wheels, truth_t_s, pose = request.getfixturevalue(which)
    wheels = wheels * np.r_[np.full(4, factor), np.ones(4)]
    with pytest.raises(DataError, match=r"wheels \(phi\) rolled .* but ground truth moved"):
        build_recording("run", Log(t_s, wheels), Log(truth_t_s, pose))


@pytest.mark.parametrize("command", ["evaluate", "calibrate", "tune"])
def test_every_command_refuses_such_a_file_by_name(tmp_path, capsys, turn, command):
    t_s, wheels, truth_t_s, pose = turn
    path = tmp_path / "rotation_cw_1.csv"
    write_plain(path, build_recording("r", Log(t_s, wheels), Log(truth_t_s, pose)))
    head, *rows = path.read_text().splitlines()
    columns = head.split(",")
    for column, factor, said in (("t", 1e9, "time (t)"), ("theta", DEG, "the heading (theta)")):
        k = columns.index(column)
        cells = [row.split(",") for row in rows]
        lines = [",".join([*c[:k], repr(float(c[k]) * factor), *c[k + 1 :]]) for c in cells]
        path.write_text("\n".join([head, *lines, ""]))
        assert main([command, str(path)]) == 2
        assert f"{path}: {said}" in capsys.readouterr().err
