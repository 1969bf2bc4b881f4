"""Recordings in other units than seconds, metres and radians are refused by every command."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.synthetic import hidden_robot, simulate
from hil.cli import main
from hil.core.errors import DataError
from hil.datasets.cleaning import Log
from hil.datasets.plain_csv import write_plain
from hil.datasets.wheel_log import build_recording

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
        (1e9, 1.7e9, "1.6e[+]07 .* 1e9 if it is in nanoseconds"),
    ],
)
def test_times_that_are_not_seconds_are_named_with_their_step(turn, factor, begin, said):
    t_s, wheels, truth_t_s, pose = turn
    with pytest.raises(DataError, match=rf"^turn\.csv: time \(t\) goes on by {said}"):
        build_recording(
            "turn",
            Log((begin + t_s) * factor, wheels),
            Log((begin + truth_t_s) * factor, pose),
            sources=("turn.csv",),
        )


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
    with pytest.raises(
        DataError,
        match=r"the heading \(theta\) (seems to be in degrees|turns by 3).*expected (theta in rad|radians)",
    ):
        build_recording("run", Log(t_s, wheels), Log(truth_t_s, np.c_[pose[:, :2], DEG * heading]))


def test_a_heading_in_radians_may_leap_at_half_a_turn_and_hold_damaged_rows(circle):
    t_s, wheels, truth_t_s, pose = circle
    heading = np.angle(np.exp(1j * (pose[:, 2] + 3.0)))
    heading[[5, 500]] = 9999.0
    found = build_recording("run", Log(t_s, wheels), Log(truth_t_s, np.c_[pose[:, :2], heading]))
    assert found.repairs == {"ground-truth rows that leap away and back dropped": 2}


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (DEG, r"wheel angles \(phi\) seem to be in degrees.*multiply phi by 0\.01745"),
        (
            1.0 / (2.0 * np.pi),
            r"wheel angles \(phi\) seem to be in revolutions.*multiply phi by 6\.28.*--bench",
        ),
        (
            4096.0 / (2.0 * np.pi),
            r"wheel angles \(phi\) seem to be in steps of 4096 a turn.*phi by 0\.001533",
        ),
        (25.4, r"wheels \(phi\) rolled .* but ground truth moved"),
    ],
)
@pytest.mark.parametrize("which", ["circle", "turn"])
def test_wheel_angles_in_another_unit_are_named(which, factor, said, request):
    t_s, wheels, truth_t_s, pose = request.getfixturevalue(which)
    wheels = wheels * np.r_[np.full(4, factor), np.ones(4)]
    with pytest.raises(DataError, match=said):
        build_recording("run", Log(t_s, wheels), Log(truth_t_s, pose))


def test_a_counter_of_revolutions_that_wraps_is_named_too(circle):
    t_s, wheels, truth_t_s, pose = circle
    wheels = np.column_stack([(wheels[:, :4] / (2.0 * np.pi)) % 1.0, wheels[:, 4:]])
    with pytest.raises(DataError, match=r"\(phi\) seem to be in revolutions"):
        build_recording("run", Log(t_s, wheels), Log(truth_t_s, pose))


@pytest.mark.parametrize(
    ("factor", "unit"), [(1e3, "millimetres"), (1e2, "centimetres"), (1 / 0.0254, "inches")]
)
def test_positions_in_another_unit_are_named(circle, factor, unit):
    t_s, wheels, truth_t_s, pose = circle
    with pytest.raises(
        DataError, match=rf"positions \(x, y\) seem to be in {unit}.*multiply x, y by {1 / factor:g}"
    ):
        build_recording("run", Log(t_s, wheels), Log(truth_t_s, pose * (factor, factor, 1.0)))


@pytest.mark.parametrize(("factor", "column"), [((1e3, 1.0, 1.0), "x"), ((1.0, 1e3, 1.0), "y")])
def test_one_position_in_another_unit_is_named_alone(circle, factor, column):
    t_s, wheels, truth_t_s, pose = circle
    with pytest.raises(
        DataError, match=rf"moved .* by ground truth \({column}\).*convert {column} to metres"
    ):
        build_recording("run", Log(t_s, wheels), Log(truth_t_s, pose * factor))


def quantized(steering):
    """Angles as counters of 4096 a turn have them."""
    count = 2.0 * np.pi / 4096.0
    return np.round(steering / count) * count


def test_steering_in_degrees_that_stays_small_is_known_by_its_counts(turn):
    """On a line it is some hundredths of a radian, in degrees within any limit."""
    t_s, wheels, truth_t_s, pose = turn
    wheels = np.array(wheels)
    wheels[:, 4:8] = quantized(0.008 * np.sin(t_s[:, None] + np.arange(4)))
    log, truth = Log(t_s, wheels), Log(truth_t_s, pose)
    assert len(build_recording("run", log, truth).t_s)
    zeros = np.array([0.0, 0.2, -0.3, 0.1])
    for spoilt in (np.degrees(wheels[:, 4:8]), np.round(np.degrees(wheels[:, 4:8]) + zeros, 6)):
        wheels = np.column_stack([wheels[:, :4], spoilt])
        with pytest.raises(DataError, match=r"steering angles \(delta\) seem to be in degrees"):
            build_recording("run", Log(t_s, wheels), truth)


def test_a_turn_of_a_mark_far_from_the_middle_is_no_other_unit(turn):
    """A turn on the spot, seen at a mark 1 m ahead: six times the way that the wheels roll."""
    t_s, wheels, truth_t_s, pose = turn
    mark = pose + np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2]), np.zeros(len(pose))])
    assert not build_recording("run", Log(t_s, wheels), Log(truth_t_s, mark)).repairs


@pytest.mark.parametrize("slip", [0.5, 1.4, 1.9])
def test_wheels_that_roll_further_or_less_far_than_the_robot_goes_are_no_other_unit(circle, slip):
    t_s, wheels, truth_t_s, pose = circle
    wheels = wheels * np.r_[np.full(4, slip), np.ones(4)]
    assert not build_recording("run", Log(t_s, wheels), Log(truth_t_s, pose)).repairs


RATES = {
    60.0
    / (
        2.0 * np.pi
    ): r"seem to be in revolutions per minute: 9\.5.*expected w in rad/s; multiply w by 0\.1047",
    1.0 / (2.0 * np.pi): r"seem to be in revolutions per second.*multiply w by 6\.28",
    DEG: r"seem to be in degrees per second.*multiply w by 0\.01745",
    1.0 / 0.0239809: r"seem to be in steps of 0\.229 revolutions per minute.*multiply w by 0\.02398",
    3.0: r"disagree with the wheel angles \(phi\): (2\.9|3).*leave out w1 to w4",
    1.5: r"disagree with the wheel angles \(phi\): 1\.[45].*leave out w1 to w4",
}


@pytest.fixture(scope="module")
def with_rates():
    return simulate(hidden_robot(1), "circle_cw", "circle_cw_1", np.random.default_rng(1))


def rebuilt(run, rate, rows=slice(None)):
    wheels = np.column_stack([run.wheel_angle_rad, run.steering_rad, rate])
    return build_recording("run.csv", Log(run.t_s[rows], wheels[rows]), Log(run.truth_t_s, run.truth_pose))


@pytest.mark.parametrize("factor", RATES)
def test_wheel_rates_in_another_unit_are_named(with_rates, factor):
    with pytest.raises(DataError, match=r"^run\.csv: wheel rates \(w1, w2, w3, w4\) " + RATES[factor]):
        rebuilt(with_rates, with_rates.wheel_rate_rad_s * factor)


def test_one_rate_of_the_wrong_sign_is_named_by_its_column(with_rates):
    with pytest.raises(DataError, match=r"wheel rates \(w3\) disagree"):
        rebuilt(with_rates, with_rates.wheel_rate_rad_s * (1.0, 1.0, -1.0, 1.0))


def test_rates_that_are_noisy_late_or_full_of_gaps_are_taken_as_they_are(with_rates):
    rng, rate = np.random.default_rng(2), with_rates.wheel_rate_rad_s
    noisy = np.roll(rate, 5, axis=0) + rng.normal(0.0, 0.3, rate.shape)
    rows = rng.uniform(size=len(rate)) < 0.3
    rows[400:480] = False
    assert rebuilt(with_rates, noisy, rows).has_rates


def stuck(run, begin_s, end_s):
    """Wheel angles whose first column stands still for a while and goes on from where it stood."""
    angle, begin, end = run.wheel_angle_rad.copy(), *np.searchsorted(run.t_s, (begin_s, end_s))
    angle[end:, 0] -= angle[end - 1, 0] - angle[begin, 0]
    angle[begin:end, 0] = angle[begin, 0]
    return angle


@pytest.mark.parametrize("end_s", [8.0, 1000.0])
def test_an_angle_that_stands_still_while_its_rate_goes_on_is_named_with_its_time(with_rates, end_s):
    run = replace(with_rates, wheel_angle_rad=stuck(with_rates, 6.0, end_s))
    with pytest.raises(DataError, match=r"phi1 stands still while w1 rolls: .* s from [56]\.. s after"):
        rebuilt(run, with_rates.wheel_rate_rad_s)


def test_an_angle_that_a_bus_repeats_for_a_while_catches_up(with_rates):
    angle, (begin, end) = with_rates.wheel_angle_rad.copy(), np.searchsorted(with_rates.t_s, (6.0, 6.9))
    angle[begin:end] = angle[begin]
    assert rebuilt(replace(with_rates, wheel_angle_rad=angle), with_rates.wheel_rate_rad_s).has_rates


def test_rates_of_a_robot_at_rest_are_not_judged(with_rates):
    rng, n = np.random.default_rng(3), len(with_rates.t_s)
    wheels = np.tile(np.r_[with_rates.wheel_angle_rad[0], with_rates.steering_rad[0]], (n, 1))
    wheels[:, :4] += rng.choice([0.0, 0.0015], (n, 4))
    pose = np.tile(with_rates.truth_pose[0], (n, 1)) + rng.normal(0.0, 1e-4, (n, 3))
    wheels = np.column_stack([wheels, rng.choice([-0.024, 0.0, 0.024], (n, 4))])
    assert build_recording("rest", Log(with_rates.t_s, wheels), Log(with_rates.t_s, pose)).has_rates


def test_rates_that_stay_zero_while_wheels_roll_were_not_recorded(with_rates):
    found = rebuilt(with_rates, np.zeros((len(with_rates.t_s), 4)))
    assert not found.has_rates
    assert found.repairs["columns of wheel rates (w) that are 0 throughout taken as not recorded"] == 4


def test_a_command_refuses_such_a_file_by_name(tmp_path, capsys):
    """As every command does that reads recordings: test_coverage_of_a_drive.py."""
    path = tmp_path / "rotation_cw_1.csv"
    write_plain(path, simulate(hidden_robot(1), "rotation_cw", "rotation_cw_1", np.random.default_rng(1)))
    head, *rows = path.read_text().splitlines()
    columns = head.split(",")
    revolutions = 1.0 / (2.0 * np.pi)
    for column, factor, said in (
        ("t", 1e9, "time (t)"),
        ("theta", DEG, "the heading (theta)"),
        ("phi", revolutions, "wheel angles (phi)"),
        ("w", 60.0 * revolutions, "wheel rates (w1, w2, w3, w4)"),
    ):
        named = [c in (column, *(f"{column}{i}" for i in range(1, 5))) for c in columns]
        lines = [
            ",".join(
                repr(float(c) * factor) if own and c else c
                for own, c in zip(named, row.split(","), strict=True)
            )
            for row in rows
        ]
        path.write_text("\n".join([head, *lines, ""]))
        assert main(["evaluate", str(path)]) == 2
        assert f"{path}: {said}" in capsys.readouterr().err


def test_stamps_in_minutes_are_no_clocks_apart(turn):
    """A drive of some seconds then lasts less than one, and both logs begin together."""
    t_s, wheels, truth_t_s, pose = turn
    with pytest.raises(DataError, match="begin together") as error:
        build_recording("turn", Log(t_s / 60.0, wheels), Log(truth_t_s / 60.0, pose))
    assert "60" in error.value.remedy


def build(run, *, phi=1.0, delta=1.0, theta=1.0):
    t_s, wheels, truth_t_s, pose = run
    return build_recording(
        "run",
        Log(t_s, wheels * np.repeat([phi, delta], 4)),
        Log(truth_t_s, pose * (1.0, 1.0, theta)),
        sources=("run.csv",),
    )


@pytest.mark.parametrize(
    ("column", "said"),
    [
        ("phi", r"in degrees or gradians.*gradians: 0\.015708"),
        ("delta", r"in gradians.*multiply delta by 0\.015708"),
        ("theta", r"in degrees or gradians.*gradians: 0\.015708"),
    ],
)
def test_gradians_are_not_called_degrees(circle, column, said):
    with pytest.raises(DataError, match=said):
        build(circle, **{column: 200.0 / np.pi})


def test_wheel_angles_times_five_are_not_called_a_heading_in_revolutions(turn):
    assert build(turn, phi=5.0).motion == "rotation_cw"


def test_rates_in_degrees_are_not_called_angles_in_degrees(circle):
    t_s, wheels, truth_t_s, pose = circle
    rate = np.gradient(wheels[:, :4], t_s, axis=0) * DEG
    none = np.full((len(t_s), 4), np.nan)
    with pytest.raises(DataError, match=r"wheel rates \(w\).* degrees per second.*multiply w by 0\.01745"):
        build_recording(
            "run",
            Log(t_s, np.column_stack([none, wheels[:, 4:8], rate])),
            Log(truth_t_s, pose),
            sources=("run.csv",),
        )
