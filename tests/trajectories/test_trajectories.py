"""Trajectories: derivatives that are derivatives, limits that are met, refusals that say when and why."""

import json
import math
import re
from bisect import bisect
from dataclasses import replace

import numpy as np
import pytest

from hil.core.errors import DataError, TrajectoryError, UsageError
from hil.core.geometry import rotation2
from hil.core.signals import Reference
from hil.live.reference_files import MOST_WAYPOINTS, read_waypoints
from hil.robot import trajectories as tr
from hil.robot.kinematics import WheelGeometry
from hil.robot.motion_limits import MotionLimits, check, slowed
from hil.robot.paths import Segment, Straight

CAD = WheelGeometry.nominal().projection()
ORIGIN = np.zeros(3)
ALL = [
    tr.line(ORIGIN, [1.5, 0, 0]),
    tr.line([0.1, 0.2, 0.1], [0.4, -0.3, -0.1]),
    tr.circle([0, 0, 0.3], 0.5),
    tr.circle(ORIGIN, 0.4, turns=-0.5, tangent=False),
    tr.rotation(ORIGIN, 2 * math.pi),
    tr.scan(ORIGIN, 1.0, 5, 0.1),
]


@pytest.mark.parametrize("trajectory", ALL, ids=lambda t: t.name)
def test_twist_and_acceleration_are_the_derivatives_of_the_pose(trajectory):
    h = 1e-5
    for t in np.linspace(0.01, trajectory.duration_s - 0.01, 57):
        before, now, after = (trajectory.sample(t + k * h) for k in (-1, 0, 1))
        velocity = (after.pose_in_wall - before.pose_in_wall) / (2 * h)
        body = rotation2(-now.pose_in_wall[2]) @ velocity[:2]
        np.testing.assert_allclose(now.twist_body, [*body, velocity[2]], atol=1e-6)
        bend = (after.pose_in_wall - 2 * now.pose_in_wall + before.pose_in_wall) / h**2
        np.testing.assert_allclose(now.acceleration_wall, bend, atol=2e-4)


@pytest.mark.parametrize("trajectory", ALL, ids=lambda t: t.name)
def test_starts_and_ends_at_rest_and_then_holds(trajectory):
    for t in (-1.0, 0.0, trajectory.duration_s, trajectory.duration_s + 5):
        np.testing.assert_allclose(trajectory.sample(t).twist_body, 0.0, atol=1e-12)
    assert trajectory.sample(trajectory.duration_s).done
    assert not trajectory.sample(trajectory.duration_s - 1e-6).done
    end = trajectory.sample(trajectory.duration_s + 1).pose_in_wall
    np.testing.assert_allclose(trajectory.sample(trajectory.duration_s - 1e-9).pose_in_wall, end, atol=1e-6)


@pytest.mark.parametrize("trajectory", ALL, ids=lambda t: t.name)
def test_time_from_limits_meets_them_and_wastes_little(trajectory):
    check(trajectory, CAD, MotionLimits(wheel_speed_m_s=0.105, wheel_acceleration_m_s2=0.21))
    with pytest.raises(TrajectoryError):
        check(trajectory, CAD, MotionLimits(wheel_speed_m_s=0.08, wheel_acceleration_m_s2=0.15))


def test_quintic_peaks_are_as_stated():
    trajectory = tr.line(ORIGIN, [1.0, 0, 0], duration_s=10.0)
    t = np.linspace(0, 10, 4001)
    speed = np.array([trajectory.sample(x).twist_body[0] for x in t])
    pull = np.array([trajectory.sample(x).acceleration_wall[0] for x in t])
    assert speed.max() == pytest.approx(tr.QUINTIC_PEAK_SPEED / 10, rel=1e-6)
    assert pull.max() == pytest.approx(tr.QUINTIC_PEAK_ACCELERATION / 100, rel=1e-5)


@pytest.mark.parametrize(
    ("name", "duration", "turn"),
    [("line_x", 80.0, 0.0), ("circle_cw", 62.83, -2 * math.pi), ("rotation_ccw", 40.02, 2 * math.pi)],
)
def test_recorded_motions(name, duration, turn):
    trajectory = tr.recorded_motion(name)
    assert trajectory.duration_s == pytest.approx(duration, abs=0.01)
    assert trajectory.sample(1e9).pose_in_wall[2] == pytest.approx(turn)
    speeds = [np.linalg.norm(trajectory.sample(t).twist_body[:2]) for t in (0.0, 1.0, duration - 1)]
    expected = 0.0 if name.startswith("rotation") else 0.05
    np.testing.assert_allclose(speeds, expected, atol=1e-9)


def test_scan_visits_every_lane_in_turn():
    trajectory = tr.scan(ORIGIN, 1.0, 3, 0.1)
    ends = []
    t = 0.0
    for segment in trajectory.segments:
        t += segment.duration_s
        ends.append(tuple(trajectory.sample(t).pose_in_wall[:2].round(9)))
    assert ends == [(1, 0), (1, 0.1), (0, 0.1), (0, 0.2), (1, 0.2)]


def test_a_refusal_names_the_first_time_and_value():
    fast = tr.line(ORIGIN, [1.0, 0, 0], duration_s=5.0)
    with pytest.raises(TrajectoryError, match=r"wheel speed .* at t = ") as error:
        check(fast, CAD, MotionLimits(wheel_acceleration_m_s2=1.0))
    assert error.value.value > 0.122
    before = fast.sample(error.value.t_s - 0.02).twist_body[0]
    assert before <= 0.122
    with pytest.raises(TrajectoryError, match="heading"):
        check(ALL[2], CAD, MotionLimits(heading_limit_rad=0.26, wheel_acceleration_m_s2=1.0))
    with pytest.raises(TrajectoryError, match="x on the wall"):
        check(ALL[0], CAD, MotionLimits(x_range_m=(0.0, 1.0), wheel_acceleration_m_s2=1.0))
    with pytest.raises(TrajectoryError, match="-y on the wall"):
        check(tr.line(ORIGIN, [0, -1.0, 0]), CAD, MotionLimits(y_range_m=(-0.5, 1.0)))
    with pytest.raises(TrajectoryError, match=r" is 1\.00002 at .*; expected at most 1;"):
        check(tr.line([-0.5003, 0, 0], [-1.0003, 0, 0]), CAD, MotionLimits(x_range_m=(-1.0, 5.0)))
    nowhere = tr.Segment(tr.Straight((0.0, 0.0, 0.0), (1.0, 0.0, math.nan)), 5.0)
    with pytest.raises(TrajectoryError, match="reference"):
        check(tr.Trajectory("nowhere", (nowhere,)), CAD, MotionLimits())


@pytest.mark.parametrize("duration_s", [1e-6, 1e-3, 0.01, 0.02])
def test_what_is_over_before_anybody_looks_is_looked_at(duration_s):
    """At rest at both of its ends, which may be all that equal steps see."""
    slow = tr.line(ORIGIN, [0.1, 0, 0])
    jump = tr.line([0.1, 0, 0], [0.9, 0, 0], duration_s=duration_s)
    for one in (
        tr.line(ORIGIN, [0.8, 0, 0], duration_s=duration_s),
        tr.Trajectory("with a jump", (*slow.segments, *jump.segments)),
    ):
        with pytest.raises(TrajectoryError, match="wheel ") as error:
            check(one, CAD, MotionLimits())
        assert 0.0 < one.duration_s - error.value.t_s <= duration_s
    way = Straight((0.0, 0.0, 0.0), (0.1 * duration_s, 0.0, 0.0))
    check(tr.Trajectory("short and slow", (Segment(way, duration_s, "constant"),)), CAD, MotionLimits())


def test_a_limit_that_is_no_number_limits_and_a_motion_without_end_is_none():
    with pytest.raises(TrajectoryError, match="wheel speed"):
        check(ALL[0], CAD, MotionLimits(wheel_speed_m_s=math.nan))
    for duration_s in (1e9, 7201.0):
        with pytest.raises(TrajectoryError, match=r"duration \(s\).*divide the motion"):
            check(tr.line(ORIGIN, [1.0, 0, 0], duration_s=duration_s), CAD, MotionLimits())


def test_waypoints_from_csv(tmp_path):
    path = tmp_path / "way.csv"
    path.write_text("x,y,theta\n0,0,0\n0.5,0,0\n0.5,0.2,0.1\n")
    trajectory = tr.through(read_waypoints(path))
    np.testing.assert_allclose(trajectory.sample(1e9).pose_in_wall, [0.5, 0.2, 0.1])
    for text, message in (
        ("x,y\n0,0\n", "no waypoint list"),
        ("x,y,theta\n0,0,0\n", "1 waypoint"),
        ("x,y,theta\n0,nan,1e9\n", "line 2 holds 0, nan, 1e"),
    ):
        path.write_text(text)
        with pytest.raises(DataError, match=message):
            read_waypoints(path)
    with pytest.raises(DataError, match="cannot be read"):
        read_waypoints(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("rows", "reported"),
    [
        ("0,0,0\n0.1,0,0\n0.1,0,0\n", "line 4 repeats the waypoint before it; expected"),
        ("0,0,0\n1e-9,0,0\n", "line 3 repeats"),
        ("0,0,0\n1e300,0,0\n", r"line 3 holds 1e\+300, 0, 0; expected finite numbers from -1000 to 1000"),
        ("0,0,nan\n1,0,0\n", "line 2 holds 0, 0, nan"),
        ("".join(f"{1e-3 * k},0,0\n" for k in range(MOST_WAYPOINTS + 1)), "holds more than 10000 waypoints"),
    ],
)
def test_waypoints_that_cannot_be_driven_name_file_and_line(tmp_path, rows, reported):
    path = tmp_path / "way.csv"
    path.write_text("x,y,theta\n" + rows)
    with pytest.raises(DataError, match=rf"way\.csv: {reported}"):
        read_waypoints(path)


def test_as_many_waypoints_as_are_allowed_are_read(tmp_path):
    path = tmp_path / "way.csv"
    path.write_text("x,y,theta\n" + "".join(f"{1e-3 * k},0,0\n" for k in range(MOST_WAYPOINTS)))
    assert len(read_waypoints(path)) == MOST_WAYPOINTS


class Asked(tuple):
    """Segments that count how many of them are looked at."""

    looked = 0

    def __getitem__(self, k):
        self.looked += 1
        return tuple.__getitem__(self, k)

    def __iter__(self):
        for k in range(len(self)):
            yield self[k]


def walked(segments, t_s):
    """Pose at a time, by walking from the first segment on."""
    left = t_s
    for segment in segments:
        if left < segment.duration_s:
            return segment.at(left)[0]
        left -= segment.duration_s
    return segments[-1].path(1.0)[0]


@pytest.mark.parametrize("count", [2, 64, 65, 4000])
def test_a_sample_late_in_a_long_chain_looks_at_few_segments(count):
    poses = [(0.01 * (k % 7), 1e-4 * k, 0.0) for k in range(count + 1)]
    segments = Asked(tr.through(poses).segments)
    trajectory = tr.Trajectory("long", segments)
    trajectory.sample(0.0)
    for t_s in np.linspace(-0.1, trajectory.duration_s + 0.1, 97):
        segments.looked = 0
        pose = trajectory.sample(t_s).pose_in_wall
        assert segments.looked <= 66
        expected = walked(tuple(tuple.__iter__(segments)), t_s)
        if count <= 64 and t_s >= 0.0:
            assert tuple(pose.tolist()) == expected
        elif t_s >= 0.0:
            np.testing.assert_allclose(pose, expected, atol=1e-9)


def test_impossible_requests_are_refused():
    with pytest.raises(UsageError, match="no length"):
        tr.line(ORIGIN, ORIGIN)
    with pytest.raises(UsageError, match="waypoint"):
        tr.through([ORIGIN])
    with pytest.raises(UsageError, match="lanes"):
        tr.scan(ORIGIN, 1.0, 0, 0.1)
    with pytest.raises(UsageError, match="line_x"):
        tr.recorded_motion("tango")


@pytest.mark.parametrize("trajectory", [*ALL, tr.recorded_motion("rotation_cw")], ids=lambda t: t.name)
def test_a_trajectory_survives_json_bit_for_bit(trajectory):
    again = tr.Trajectory.from_mapping(json.loads(json.dumps(trajectory.to_mapping())))
    assert again == trajectory
    for t_s in np.linspace(-1, trajectory.duration_s + 1, 57):
        a, b = trajectory.sample(t_s), again.sample(t_s)
        assert np.array_equal(a.pose_in_wall, b.pose_in_wall)
        assert np.array_equal(a.twist_body, b.twist_body)


@pytest.mark.parametrize("data", [{}, {"name": "x", "segments": [{"kind": "spiral"}]}, {"name": 1}])
def test_what_is_no_trajectory_is_refused(data):
    with pytest.raises(UsageError, match="no trajectory"):
        tr.Trajectory.from_mapping(data)


class Turning:
    """A reference that stands at a heading and begins to move and to turn."""

    name, duration_s, segments = "turning", 0.0, ()

    def __init__(self, heading_rad, acceleration):
        self.now = Reference(0.0, np.array([0, 0, heading_rad]), np.zeros(3), np.array(acceleration, float))

    def sample_many(self, times_s):
        now = self.now
        return tuple(
            np.tile(value, (len(times_s), 1))
            for value in (now.pose_in_wall, now.twist_body, now.acceleration_wall)
        )


@pytest.mark.parametrize("heading", [0.0, 0.7, -0.7, 2.0])
def test_the_pull_on_a_wheel_is_that_of_its_place_on_the_wall(heading):
    """Acceleration in wall axes and a turn: each wheel's own is a + alpha x its place in wall axes."""
    acceleration, alpha = np.array([0.3, -0.1]), 2.0
    places = np.column_stack([CAD[1::2, 2], -CAD[0::2, 2]]) @ rotation2(heading).T
    pull = np.hypot(acceleration[0] - alpha * places[:, 1], acceleration[1] + alpha * places[:, 0]).max()
    reference = Turning(heading, [*acceleration, alpha])
    check(reference, CAD, MotionLimits(wheel_acceleration_m_s2=pull + 1e-6))
    with pytest.raises(TrajectoryError, match="wheel acceleration") as error:
        check(reference, CAD, MotionLimits(wheel_acceleration_m_s2=pull - 1e-5))
    assert error.value.value == pytest.approx(pull)


def test_limits_hold_at_their_very_value():
    way = tr.line(ORIGIN, [0.5, 0, 0], duration_s=10.0)
    tight = {"wheel_speed_m_s": 1.875 * 0.5 / 10.0, "wheel_acceleration_m_s2": 5.7735027 * 0.5 / 100.0}
    check(way, CAD, MotionLimits(**tight, x_range_m=(0.0, 0.5), y_range_m=(0.0, 0.0)))
    for key in tight:
        with pytest.raises(TrajectoryError):
            check(way, CAD, MotionLimits(**{**tight, key: 0.999 * tight[key]}))
    with pytest.raises(TrajectoryError, match="-x on the wall"):
        check(way, CAD, MotionLimits(x_range_m=(1e-6, 1.0)))


def test_a_range_that_begins_beyond_zero_holds_at_its_very_beginning():
    way = tr.line([0.5, 0.25, 0.0], [1.0, 0.25, 0.0], duration_s=20.0)
    check(way, CAD, MotionLimits(x_range_m=(0.5, 1.0), y_range_m=(0.25, 0.25)))
    with pytest.raises(TrajectoryError, match="-x on the wall"):
        check(way, CAD, MotionLimits(x_range_m=(0.5 + 1e-5, 1.0)))


def refused(way, limits):
    try:
        check(way, CAD, MotionLimits(**limits))
    except TrajectoryError:
        return True
    return False


@pytest.mark.parametrize("way", ALL, ids=lambda way: way.name)
@pytest.mark.parametrize("limit", ["wheel_speed_m_s", "wheel_acceleration_m_s2"])
def test_what_is_a_little_too_fast_is_driven_slower_along_the_same_way(way, limit):
    falling = 0.25 * 0.998 ** np.arange(3000)
    reached = falling[bisect(falling, False, key=lambda value: refused(way, {limit: value}))]
    limits = MotionLimits(**{limit: 0.95 * reached})
    slower = slowed(way, CAD, limits, at_most=1.1)
    check(slower, CAD, limits)
    longer = slower.duration_s / way.duration_s
    assert 1.02 < longer < 1.07
    for share in (0.0, 0.3, 0.5, 1.0):
        before, after = (t.sample(share * t.duration_s) for t in (way, slower))
        assert after.pose_in_wall == pytest.approx(before.pose_in_wall, abs=1e-12)
        assert longer * after.twist_body == pytest.approx(before.twist_body, abs=1e-12)
    assert refused(slower, {limit: 0.93 * reached})
    assert slowed(way, CAD, limits, at_most=1.01) is way
    assert slowed(way, CAD, MotionLimits(), at_most=1.1) is way


@pytest.mark.parametrize("way", ALL[:5], ids=lambda way: way.name)
def test_a_refusal_says_in_which_time_the_same_way_can_be_driven(way):
    quick = replace(way, segments=tuple(replace(s, duration_s=0.2 * s.duration_s) for s in way.segments))
    with pytest.raises(TrajectoryError) as refusal:
        check(quick, CAD, MotionLimits())
    takes_s = float(re.search(r"([\d.]+) s instead of", refusal.value.remedy)[1])
    for share, passes in ((1.0, True), (0.95, False)):
        longer = share * takes_s / quick.duration_s
        other = replace(
            quick, segments=tuple(replace(s, duration_s=longer * s.duration_s) for s in quick.segments)
        )
        assert refused(other, {}) is not passes


@pytest.mark.parametrize(("pull", "held"), [(0.19, True), (0.21, False)])
def test_who_names_no_limit_has_wheels_that_gain_a_fifth_of_a_metre_per_second_in_a_second(pull, held):
    reference = Turning(0.0, [pull, 0.0, 0.0])
    if held:
        check(reference, CAD, MotionLimits())
    else:
        with pytest.raises(TrajectoryError, match="wheel acceleration"):
            check(reference, CAD, MotionLimits())


def test_only_the_segments_that_a_known_trajectory_ends_with_are_not_looked_at_again():
    """One that is too fast is refused wherever it is new, and not where it was accepted before."""
    slow, fast = (tr.line(ORIGIN, [0.5, 0, 0], duration_s=t_s).segments[0] for t_s in (20.0, 2.0))
    end, other_end = (tr.line(ORIGIN, [0.3, 0, 0]).segments[0] for _ in range(2))
    known = tr.Trajectory("known", (slow, slow, end))
    for parts in ((fast, end), (slow, fast, end), (slow, fast, slow, end), (slow, fast), (fast, other_end)):
        with pytest.raises(TrajectoryError, match="wheel acceleration"):
            check(tr.Trajectory("new", parts), CAD, MotionLimits(), known=known)
    accepted = tr.Trajectory("accepted", (fast, end))
    check(tr.Trajectory("new", (slow, fast, end)), CAD, MotionLimits(), known=accepted)


@pytest.mark.parametrize("wrong", [-6, 0.0, math.nan, math.inf, "6"])
@pytest.mark.parametrize("name", ["duration_s", "speed_m_s", "acceleration_m_s2"])
def test_a_duration_or_speed_that_is_none_is_refused(name, wrong):
    with pytest.raises(UsageError, match=f"{name} is "):
        tr.line(ORIGIN, [1.0, 0, 0], **{name: wrong})


def test_a_duration_is_what_it_says():
    assert tr.line(ORIGIN, [1.0, 0, 0], duration_s=6).duration_s == 6
    assert tr.line(ORIGIN, [1.0, 0, 0]).duration_s == tr.line(ORIGIN, [1.0, 0, 0], duration_s=None).duration_s
