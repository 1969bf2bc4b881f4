"""Ground truth is corrected where wheels and truth measure the cause: clock, heading, centre of its body."""

import re
from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.evaluation import position_rmse, track
from hil.calibration.excitation import mismatch
from hil.calibration.synthetic import OTHER_MOTIONS, HiddenRobot, hidden_robot, make_set
from hil.cli import main
from hil.core.errors import DataError
from hil.datasets.cleaning import Log
from hil.datasets.fit_blocks import reduce_recordings
from hil.datasets.nominal_robot import Nominal
from hil.datasets.plain_csv import write_plain
from hil.datasets.truth_correction import corrected, notes_of
from hil.datasets.truth_fit import truth_fit
from hil.datasets.truth_moves import SMOOTHED
from hil.datasets.wheel_log import build_recording
from hil.robot.kinematics import WheelGeometry

CAD = WheelGeometry.nominal()


@pytest.fixture(scope="module")
def data():
    return make_set(hidden_robot(2, contact="elastic"), 2, repetitions=1)


@pytest.fixture(scope="module")
def perfect():
    robot = HiddenRobot(CAD, np.ones(4))
    return make_set(
        robot, 6, ("line_x", "line_y", "circle_ccw", "rotation_cw"), 2, run_to_run=0.0, slip_share=0
    )


def error_mm(recordings):
    return 1e3 * max(position_rmse(track(one, CAD)) for one in recordings)


def test_slips_on_a_line_are_no_heading_of_the_truth():
    """Of a line with three slips the free fit says 0.04 rad, by a tracked point half a metre away."""
    line, *_ = make_set(hidden_robot(316, contact="elastic"), 316, repetitions=3)[3:]
    assert line.name == "line_y_1"
    assert abs(truth_fit(line).heading_rad) > 0.03
    (alone,) = corrected([line])
    assert alone.truth_pose == pytest.approx(line.truth_pose)
    assert (alone.notes, alone.contradictions) == ((), ())


def late(one, by_s):
    return replace(one, truth_t_s=one.truth_t_s + by_s)


def fast(one, share):
    return replace(one, truth_t_s=one.truth_t_s[0] + (one.truth_t_s - one.truth_t_s[0]) * (1.0 + share))


def turned(one, by_rad):
    return replace(one, truth_pose=one.truth_pose + np.array([0.0, 0.0, by_rad]))


def off_centre(one, ahead_m, left_m):
    pose = one.truth_pose.copy()
    point = complex(ahead_m, left_m) * np.exp(1j * pose[:, 2])
    pose[:, :2] += np.column_stack([point.real, point.imag])
    return replace(one, truth_pose=pose)


def leaping(one, by_s):
    """The clock of wheels and truth leaps in the middle."""
    middle_s = one.t_s[len(one.t_s) // 2]
    return replace(
        one,
        t_s=one.t_s + by_s * (one.t_s >= middle_s),
        truth_t_s=one.truth_t_s + by_s * (one.truth_t_s >= middle_s),
    )


@pytest.mark.timeout(60)
def test_a_clock_that_leaps_by_days_is_compared_but_for_the_leap(data):
    one = late(leaping(data[0], 300_000.0), 0.2)
    assert truth_fit(one).late_s == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize("by_s", [-0.6, -0.2, 0.06, 0.2])
def test_a_delay_is_measured_to_hundredths_of_a_second(data, by_s):
    found = [truth_fit(late(one, by_s)) for one in data]
    assert [fit.late_s for fit in found] == pytest.approx([by_s] * len(data), abs=0.02)
    (line,) = notes_of(corrected([late(one, by_s) for one in data]))
    assert f"moves {abs(by_s):.2f} s {'later' if by_s > 0 else 'earlier'} than the wheels" in line


@pytest.mark.parametrize("share", [-0.002, 0.002, 0.01, 0.05])
def test_a_clock_that_runs_fast_is_a_stretch_and_no_delay(perfect, share):
    spoilt = [fast(one, share) for one in perfect]
    (line,) = notes_of(put_right := corrected(spoilt))
    assert f"{100 * abs(share / (1 + share)):.2f} % {'fast' if share > 0 else 'slow'}" in line
    assert error_mm(put_right) < 1.1 * error_mm(perfect) + 0.1
    assert error_mm(spoilt) > 2.0 * error_mm(put_right)


def test_what_agrees_is_not_changed(data, perfect):
    others = make_set(hidden_robot(3, contact="coulomb"), 3, OTHER_MOTIONS, 2, corrupted="arc_1")
    for good in (data, perfect, others):
        for one, same in zip(good, corrected(good), strict=True):
            assert one is same


def test_a_robot_that_never_rests_or_never_moves_is_left_alone(data):
    steady = data[0]
    inside = (steady.t_s > 5.0) & (steady.t_s < 15.0)
    cut = replace(
        steady,
        t_s=steady.t_s[inside],
        wheel_angle_rad=steady.wheel_angle_rad[inside],
        steering_rad=steady.steering_rad[inside],
    )
    still = replace(steady, wheel_angle_rad=np.zeros_like(steady.wheel_angle_rad))
    for one in (late(cut, 0.2), still):
        assert corrected([one]) == [one]


@pytest.mark.parametrize("way", [0.01, 1.0, 100.0], ids=["slow", "as it is", "fast"])
def test_speeds_that_are_not_alike_tell_nothing_however_fast(data, way):
    """Wheels that roll in one second of twenty, and ground truth that moves all the time."""
    one = data[0]
    t_s = np.arange(0.0, 20.0, 0.01)
    rolled = way * np.clip(t_s - 9.0, 0.0, 1.0)
    pose = way * np.column_stack([0.05 * t_s, 0.02 * np.sin(5.0 * t_s), np.zeros_like(t_s)])
    apart = replace(
        one,
        t_s=t_s,
        wheel_angle_rad=np.outer(rolled, np.ones(4)),
        steering_rad=np.zeros((len(t_s), 4)),
        truth_t_s=t_s,
        truth_pose=pose,
    )
    assert truth_fit(apart) is None


def test_evaluate_says_so(tmp_path, capsys, data):
    write_plain(tmp_path / "line_x_1.csv", late(data[0], 0.2))
    assert main(["evaluate", str(tmp_path)]) == 0
    assert "the ground truth moves 0.20 s later than the wheels" in capsys.readouterr().err


def slow(one, by_s, period_s):
    """Ground truth of a clock that is late, thinned to one row in a period."""
    every = round(period_s / float(np.median(np.diff(one.truth_t_s))))
    rows = slice(every // 3, None, every)
    return replace(
        one,
        truth_t_s=one.truth_t_s[rows] + by_s,
        truth_pose=one.truth_pose[rows],
        truth_receive_s=one.truth_receive_s[rows],
    )


@pytest.mark.parametrize("period_s", [0.2, 0.4, 1.0])
def test_ground_truth_at_a_low_rate_is_no_other_clock(data, period_s):
    for one in data:
        assert truth_fit(slow(one, 0.0, period_s)).late_s == pytest.approx(0.0, abs=0.03 + 0.1 * period_s)
        assert notes_of(corrected([slow(one, 0.0, period_s)])) == []


@pytest.mark.parametrize("period_s", [0.2, 1.0])
def test_a_late_clock_shows_at_a_low_rate_too(data, period_s):
    (line,) = notes_of(corrected([slow(one, 0.3, period_s) for one in data]))
    assert "the ground truth moves 0.3" in line or "the ground truth moves 0.29" in line
    assert "later" in line


@pytest.mark.parametrize("by_rad", [-0.35, 0.05, 0.087, 0.9])
def test_a_heading_off_the_direction_of_travel_is_corrected_and_both_causes_said(perfect, by_rad):
    (line,) = notes_of(put_right := corrected([turned(one, by_rad) for one in perfect]))
    assert f"{by_rad:.3f} rad" in line
    assert "four steering zeros" in line
    assert error_mm(put_right) == pytest.approx(error_mm(perfect), rel=0.1)


@pytest.mark.parametrize(("ahead_m", "left_m"), [(0.05, 0.0), (0.0, -0.05), (-0.1, 0.03)])
@pytest.mark.parametrize("by_rad", [0.0, 0.2])
def test_a_body_off_centre_is_corrected_with_its_place_on_the_robot(perfect, ahead_m, left_m, by_rad):
    spoilt = [turned(off_centre(one, ahead_m, left_m), by_rad) for one in perfect]
    line = notes_of(put_right := corrected(spoilt))[-1]
    assert f"{1e3 * ahead_m:.0f} mm ahead and {1e3 * left_m:.0f} mm to the left" in line.replace(
        "-0 mm", "0 mm"
    )
    assert error_mm(put_right) < error_mm(perfect) + 0.5


def test_a_body_turned_by_a_quarter_is_refused_as_that(perfect):
    for by_rad in (-np.pi / 2, np.pi / 2):
        found = corrected([turned(one, by_rad) for one in perfect])
        assert all(f"moves {-by_rad:.3f} rad" in one.contradictions[0] for one in found)


def test_the_frame_of_the_capture_system_does_not_matter(perfect):
    def rotated(one, by_rad):
        x, y, theta = one.truth_pose.T
        c, s = np.cos(by_rad), np.sin(by_rad)
        return replace(
            one, truth_pose=np.column_stack([c * x - s * y + 3.0, s * x + c * y - 7.0, theta + by_rad])
        )

    for by_rad in (np.radians(10.0), np.pi / 2, np.pi):
        spoilt = [rotated(one, by_rad) for one in perfect]
        assert notes_of(corrected(spoilt)) == []
        assert error_mm(spoilt) == pytest.approx(error_mm(perfect), rel=1e-6)


@pytest.mark.parametrize(
    "other",
    [lambda one: turned(one, 0.12), lambda one: off_centre(one, 0.04, 0.0)],
    ids=["heading", "centre"],
)
def test_a_body_that_differs_in_some_recordings_contradicts_the_others(perfect, other):
    some = [other(one) if k in (2, 6) else one for k, one in enumerate(perfect)]
    found = corrected(some)
    assert notes_of(found) == []
    named = {one.name for one in found if one.contradictions}
    assert named
    assert named <= {perfect[2].name, perfect[6].name}


def test_clocks_years_apart_are_refused_with_their_distance(data):
    one = data[0]
    wheels = np.column_stack([one.wheel_angle_rad, one.steering_rad])
    with pytest.raises(DataError, match=r"54.* years\) after the wheels") as raised:
        build_recording("a", Log(one.t_s, wheels), Log(one.truth_t_s + 1.7147e9, one.truth_pose))
    assert "1714700000" in raised.value.remedy


def stretched(one, matrix):
    pose = one.truth_pose.copy()
    pose[:, :2] = pose[:, :2] @ np.transpose(matrix)
    return replace(one, truth_pose=pose)


def drifting(one, rate_rad_s):
    drift = rate_rad_s * (one.truth_t_s - one.truth_t_s[0])
    return replace(one, truth_pose=one.truth_pose + np.outer(drift, [0.0, 0.0, 1.0]))


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (lambda one: stretched(one, [[1.0, 0.0], [0.0, 1.05]]), r"depend on their direction, by [45]\.\d %"),
        (lambda one: stretched(one, [[1.0, 0.1], [0.0, 1.0]]), r"depend on their direction, by (9|10)\.\d %"),
        (lambda one: drifting(one, 0.004), r"drifts by 0\.00[34]\d rad/s"),
        (lambda one: drifting(one, -0.004), r"drifts by -0\.00[34]\d rad/s"),
    ],
    ids=["one axis longer", "sheared", "drift", "drift back"],
)
def test_what_no_clock_heading_or_centre_explains_is_refused_as_what_it_is(perfect, spoil, named):
    found = corrected([spoil(one) for one in perfect])
    assert notes_of(found) == []
    for one in found:
        (said,) = one.contradictions
        assert re.search(named, said), said


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (lambda one: stretched(one, [[1.0, 0.0], [0.0, 1.05]]), "depend on their direction"),
        (lambda one: stretched(one, 1.05 * np.eye(2)), r"are 1\.0[45]\d times those of the other"),
        (lambda one: drifting(one, 0.004), r"drifts by 0\.00[34]\d rad/s"),
        (lambda one: turned(one, 0.05), r"is 0\.05 rad off .* or all its steering angles are -0\.05 rad off"),
    ],
    ids=["one axis longer", "all longer", "drift", "heading"],
)
def test_what_is_wrong_with_one_recording_is_named_there_alone(perfect, spoil, named):
    """Number 4 is a circle, in which axes show; number 0 a line, in which lengths, drift and heading do."""
    number = 4 if "direction" in named else 0
    found = corrected([spoil(one) if k == number else one for k, one in enumerate(perfect)])
    (said,) = found[number].contradictions
    assert re.search(named, said), said
    assert not any(one.contradictions for k, one in enumerate(found) if k != number)


def test_the_clock_of_one_recording_is_corrected_there_alone(perfect):
    spoilt = [fast(perfect[0], 0.005), *perfect[1:]]
    (line,) = notes_of(put_right := corrected(spoilt))
    assert f"+0.50 % in {perfect[0].name}; these stamps are corrected" in line
    assert error_mm(put_right) < 1.1 * error_mm(perfect) + 0.1
    for one, same in zip(put_right[1:], perfect[1:], strict=True):
        np.testing.assert_array_equal(one.truth_t_s, same.truth_t_s)


def test_a_clock_that_runs_unevenly_is_no_stretch():
    """Shown by a motion that stops on its way."""
    robot = HiddenRobot(CAD, np.ones(4))
    scans = make_set(robot, 6, ("scan",), 2, run_to_run=0.0, slip_share=0)
    found = corrected([late(one, 0.06 * np.sin(one.truth_t_s / 3.0)) for one in scans])
    assert notes_of(found) == []
    assert all("runs unevenly" in one.contradictions[0] for one in found)
    assert corrected(scans) == scans


@pytest.mark.parametrize("scale", [0.95, 1.05])
def test_a_scale_of_all_positions_is_said_with_both_causes(perfect, scale):
    (line,) = notes_of(corrected([stretched(one, scale * np.eye(2)) for one in perfect]))
    assert float(re.search(r"goes (\d\.\d+) times", line)[1]) == pytest.approx(scale, abs=0.004)
    assert "radii" in line


def test_a_scale_that_no_radius_can_have_is_refused_and_noise_is_no_distance(perfect):
    def found(recordings):
        return mismatch(reduce_recordings(recordings, 0.1), Nominal())

    assert "went 1.10 times as far" in found([stretched(one, 1.1 * np.eye(2)) for one in perfect])
    rng = np.random.default_rng(5)
    noisy = [
        replace(one, truth_pose=one.truth_pose + rng.normal(0, [3e-3, 3e-3, 4e-3], one.truth_pose.shape))
        for one in perfect
    ]
    assert found(noisy) == ""


def averaged(one, over_s):
    """Ground truth of which each pose is the mean of those over so many seconds about it."""
    rows = round(over_s / float(np.median(np.diff(one.truth_t_s)))) // 2 * 2 + 1
    padded = np.pad(one.truth_pose, ((rows // 2, rows // 2), (0, 0)), mode="edge")
    sums = np.cumsum(np.vstack([np.zeros(3), padded]), axis=0)
    return replace(one, truth_pose=(sums[rows:] - sums[:-rows]) / rows)


def test_averaged_poses_are_called_smoother_and_not_late_or_fast_or_drifting(data):
    smoothed = corrected([averaged(one, 1.0) for one in data])
    assert notes_of(smoothed) == []
    assert all("smoother than the motion of the wheels" in one.contradictions[0] for one in smoothed)
    assert not any(one.contradictions for one in corrected(data))


@pytest.mark.parametrize("over_s", [0.4, 0.6])
def test_the_variance_of_an_average_is_measured(perfect, over_s):
    fits = [truth_fit(averaged(one, over_s)) for one in perfect]
    found_s2 = np.median([fit.causes[SMOOTHED].values[0] for fit in fits])
    assert found_s2 == pytest.approx(over_s**2 / 12.0, rel=0.5)


def test_one_wheel_set_wrongly_is_not_called_a_heading_of_the_ground_truth(perfect):
    off = [replace(one, steering_rad=one.steering_rad + np.array([0.3, 0.0, 0.0, 0.0])) for one in perfect]
    assert notes_of(corrected(off)) == []
