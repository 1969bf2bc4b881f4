"""A trajectory at many times at once is that at each of them, and is refused for the same reason."""

import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import TrajectoryError
from hil.live.reference_files import MOST_WAYPOINTS
from hil.robot import trajectories as tr
from hil.robot.kinematics import WheelGeometry
from hil.robot.motion_limits import MotionLimits, check
from hil.robot.paths import Segment, Straight

CAD = WheelGeometry.nominal().projection()

NUMBERS = st.floats(-1.0, 1.0)
POSES = st.tuples(NUMBERS, NUMBERS, st.floats(-4.0, 4.0))
WAYS = st.floats(0.01, 1.0).flatmap(lambda way: st.sampled_from([way, -way]))
LAWS = st.sampled_from(["quintic", "constant"])
DWELLS = st.builds(
    lambda pose, duration_s, law: tr.Trajectory("dwell", (Segment(Straight(pose, pose), duration_s, law),)),
    POSES,
    st.sampled_from([0.1, 0.25, 1.0, 1.0 / 3.0]),
    LAWS,
)
LINES = st.builds(lambda a, way, law: tr.line(a, (a[0] + way, a[1], a[2] + 0.1), law=law), POSES, WAYS, LAWS)
TURNS = st.builds(lambda a, way, law: tr.rotation(a, way, law=law), POSES, WAYS, LAWS)
CIRCLES = st.builds(
    lambda a, radius_m, turns, law, tangent: tr.circle(a, radius_m, turns=turns, law=law, tangent=tangent),
    POSES,
    st.floats(0.01, 0.4),
    WAYS,
    LAWS,
    st.booleans(),
)
SCANS = st.builds(lambda a, lanes: tr.scan(a, 0.3, lanes, 0.05), POSES, st.integers(1, 5))
LONG = st.builds(
    lambda count: tr.through([(0.01 * (k % 7), 1e-4 * k, 0.001 * k) for k in range(count)]),
    st.sampled_from([2, 64, 65, 66, 129, 400]),
)
RECORDED = st.sampled_from(
    ["line_x", "line_y", "circle_ccw", "circle_cw", "rotation_ccw", "rotation_cw"]
).map(tr.recorded_motion)
ONE = st.one_of(DWELLS, LINES, TURNS, CIRCLES, SCANS, LONG)
COMPOSED = st.lists(ONE, min_size=1, max_size=5).map(
    lambda parts: tr.Trajectory("composed", tuple(s for part in parts for s in part.segments))
)
ANY = st.one_of(ONE, COMPOSED)


class OneByOne:
    """A trajectory of which many times are looked up one after the other."""

    def __init__(self, trajectory):
        self.trajectory, self.name, self.duration_s = trajectory, trajectory.name, trajectory.duration_s
        self.segments = trajectory.segments

    def sample_many(self, times_s):
        found = [self.trajectory.sample(t_s) for t_s in np.asarray(times_s).tolist()]
        return tuple(
            np.array([getattr(now, name) for now in found])
            for name in ("pose_in_wall", "twist_body", "acceleration_wall")
        )


def corners_s(trajectory):
    """Before the start, the start, where segments meet and just beside, the end, long after."""
    meets_s = np.array([0.0, *np.cumsum([part.duration_s for part in trajectory.segments])])
    beside_s = [np.nextafter(meets_s, -1.0), np.nextafter(meets_s, 1e9)]
    return np.concatenate([[-1.0, -1e-9], meets_s, *beside_s, meets_s + 1e-3, [trajectory.duration_s, 1e9]])


@given(trajectory=ANY | RECORDED, parts=st.lists(st.floats(-0.1, 1.1), max_size=20))
def test_many_times_at_once_are_each_of_them(trajectory, parts):
    times_s = np.concatenate([corners_s(trajectory), np.array(parts) * trajectory.duration_s])
    found = trajectory.sample_many(times_s)
    for many, single in zip(found, OneByOne(trajectory).sample_many(times_s), strict=True):
        assert many.shape == (len(times_s), 3)
        np.testing.assert_allclose(many, single, rtol=1e-12, atol=1e-12)


def refusal(trajectory, limits):
    """What is said against a trajectory: time, quantity, limit and value; None when nothing is."""
    try:
        check(trajectory, CAD, limits)
    except TrajectoryError as error:
        return error.t_s, error.quantity, error.limit, pytest.approx(error.value, rel=1e-12)
    return None


@given(
    trajectory=ANY,
    limits=st.builds(
        MotionLimits,
        wheel_speed_m_s=st.floats(0.02, 0.13),
        wheel_acceleration_m_s2=st.floats(0.03, 0.25),
        heading_limit_rad=st.none() | st.floats(0.1, 3.0),
        x_range_m=st.none() | st.tuples(st.floats(-2.0, 0.0), st.floats(0.0, 2.0)),
        y_range_m=st.none() | st.tuples(st.floats(-2.0, 0.0), st.floats(0.0, 2.0)),
    ),
)
def test_a_refusal_is_the_same_as_by_looking_one_by_one(trajectory, limits):
    assert refusal(trajectory, limits) == refusal(OneByOne(trajectory), limits)


@pytest.mark.parametrize("where", [1, 20_000, 20_001])
def test_the_first_of_many_offences_is_reported_wherever_it_comes(where):
    """Stretches of 10 ms: that which is too quick, and a later one that is quicker."""
    slow, quick, quicker = (
        Segment(Straight((0.0, 0.0, 0.0), (0.01 * speed_m_s, 0.0, 0.0)), 0.01, "constant")
        for speed_m_s in (0.1, 1.0, 2.0)
    )
    parts = [slow] * (where + 10)
    parts[where], parts[where + 5] = quick, quicker
    with pytest.raises(TrajectoryError, match="wheel speed") as error:
        check(tr.Trajectory("short stretches", tuple(parts)), CAD, MotionLimits())
    assert error.value.t_s == pytest.approx(0.01 * where, abs=0.0100001)
    assert error.value.value == pytest.approx(1.0)


@pytest.mark.parametrize("value", [math.nan, -math.inf])
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_what_is_no_number_in_the_middle_is_reported_with_its_time(value):
    good = tr.line((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), duration_s=2.0).segments[0]
    for axis in range(3):
        end = tuple(value if k == axis else 0.0 for k in range(3))
        bad = Segment(Straight((0.1, 0.0, 0.0), end), 2.0)
        with pytest.raises(TrajectoryError, match="reference is nan") as error:
            check(tr.Trajectory("odd", (good, bad)), CAD, MotionLimits())
        assert error.value.t_s == pytest.approx(2.0)


def test_as_many_waypoints_as_are_allowed_are_checked_while_one_waits():
    """Ten thousand waypoints, close together: 0.6 s on a computer on which one by one took 9.3 s."""
    way = tr.through([(0.01 * (k % 2), 1e-3 * k, 0.0) for k in range(MOST_WAYPOINTS)])
    begin_s = time.process_time()
    check(way, CAD, MotionLimits())
    assert time.process_time() - begin_s < 0.25 * _one_by_one_s(way)


def _one_by_one_s(way):
    """What as many single samples would cost, by a fiftieth of them."""
    times_s = np.arange(0.0, way.duration_s, 0.5).tolist()
    begin_s = time.process_time()
    for t_s in times_s:
        way.sample(t_s)
    return 50.0 * (time.process_time() - begin_s)
