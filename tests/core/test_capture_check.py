"""Motion capture beside camera and wheels: who is alone with the way that it reports is named."""

from dataclasses import replace

import numpy as np
import pytest
from supervised import Supervised

from hil.core.errors import SafetyStop
from hil.core.signals import GyroMeasurement, Inputs, Measurements, PoseMeasurement, Stamp, WheelMeasurement
from hil.loop.checks.cusum import CAMERA, WHEELS, Disagreement, Relocalisation, Sum
from hil.loop.checks.dead_reckoning import WheelTrack
from hil.loop.checks.exclusion import Exclusion
from hil.loop.checks.mocap_agreement import MocapAgreement, MocapTolerances
from hil.loop.checks.motion_agreement import MotionCheck
from hil.loop.cycle_data import Cycle
from hil.loop.safety_limits import Checks, SafetyLimits
from hil.robot.kinematics import WheelGeometry, inverse

GEOMETRY = WheelGeometry.nominal()
PERIOD_NS = 10_000_000
UP, ACROSS = np.array([0.1, 0.0]), np.array([0.0, 0.1])
CREEP = np.array([-0.036, 0.0])

HOLDERS = {"adhesion": "fan", "thrust": "propellers"}


def pose(name, t_ns, now_ns, place, heading_rad=0.0, valid=True):
    return PoseMeasurement(Stamp(t_ns, now_ns, 0), name, np.array([*place, heading_rad]), 3, valid)


def cycle(k, rolled, seen, captured, *, axes_rad=0.0, mocap=True):
    """Straight ahead: ways (2,) as functions of time, m; the rigid body's axes may be turned."""
    t_ns = k * PERIOD_NS
    way = np.hypot(*rolled(t_ns * 1e-9))
    _, steering = inverse(GEOMETRY, np.array([*rolled(1.0), 0.0]))
    angle = way / GEOMETRY.radius_m
    late_ns, soon_ns = t_ns - 25_000_000, t_ns - 5_000_000
    return Measurements(
        k,
        t_ns,
        wheels=(WheelMeasurement(Stamp(t_ns, t_ns, k), angle, angle, steering, (True,) * 4),),
        tracker=(pose("tracker", late_ns, t_ns, seen(late_ns * 1e-9)),),
        mocap=(pose("mocap", soon_ns, t_ns, captured(soon_ns * 1e-9), axes_rad),) if mocap else (),
    )


def at(speed_m_s):
    """Way (2,) at a constant speed (2,), as a function of time."""
    return lambda t_s: np.asarray(speed_m_s) * t_s


def doubts(rolled, seen, captured, cycles=400, **options):
    check = MotionCheck(GEOMETRY)
    given = [cycle(k, at(rolled), at(seen), at(captured), **options) for k in range(3, cycles)]
    return [(k * PERIOD_NS * 1e-9, d) for k, m in enumerate(given, 3) for d in check.update(m)]


def true_of(rolled):
    """What a robot does whose wheels roll like this on a wall: it creeps down."""
    return rolled + CREEP * np.hypot(*rolled)


@pytest.mark.parametrize(("rolled", "scale"), [(UP, 0.987), (ACROSS, 1.0), (-UP, 1.013), (ACROSS, 0.987)])
def test_honest_sensors_on_a_creeping_robot_leave_nothing_to_doubt(rolled, scale):
    true = true_of(rolled)
    assert doubts(rolled, true * scale, true, 800, axes_rad=0.03) == []


@pytest.mark.parametrize("rolled", [UP, ACROSS])
@pytest.mark.parametrize("scale", [0.9, 1.1])
def test_a_tenth_of_scale_is_found_where_motion_capture_looks_on(rolled, scale):
    """Beside wheels that creep it cannot be distinguished from creep."""
    true = true_of(rolled)
    (reported_s, first), *_ = doubts(rolled, true * scale, true)
    assert first.source == "tracker"
    assert 0.1 * np.hypot(*true) * reported_s < 0.015
    assert doubts(rolled, true * scale, true, 160, mocap=False) == []


def test_wheels_that_slip_are_named():
    found = doubts(UP, 0.6 * UP, 0.6 * UP)
    assert {d.source for _, d in found} == {"servos"}
    assert any(d.grave and d.confirmed for _, d in found)
    assert "agree against the wheels" in found[-1][1].message
    assert {d.against for _, d in found} >= {"mocap"}


def test_motion_capture_that_is_wrong_is_named_itself():
    found = doubts(UP, UP, 0.7 * UP)
    assert {d.source for _, d in found} == {"mocap"}


def test_a_frame_that_is_not_valid_and_a_gap_begin_anew():
    """The body may be another behind it."""
    check, found = MotionCheck(GEOMETRY), []
    for k in range(3, 300):
        given = cycle(k, at(UP), at(UP), at(UP))
        off = 0.015 * (k > 100)
        (seen,) = given.mocap
        seen = replace(seen, pose=np.add(seen.pose, [off, 0.0, 0.0]), valid=k not in range(98, 101))
        found += check.update(replace(given, mocap=(seen,)))
    assert found == []


def test_wheels_that_slip_are_found_without_a_camera_too():
    check, found = MotionCheck(GEOMETRY), []
    for k in range(3, 300):
        found += check.update(replace(cycle(k, at(UP), at(UP), at(0.6 * UP)), tracker=()))
    assert any(d.grave for d in found)


def test_a_reset_forgets_the_way_of_motion_capture():
    check = MotionCheck(GEOMETRY)
    for k in range(3, 60):
        check.update(cycle(k, at(UP), at(UP), at(0.8 * UP)))
    check.reset()
    assert [d for k in range(60, 200) for d in check.update(cycle(k, at(UP), at(UP), at(UP)))] == []


@pytest.mark.parametrize(
    ("device", "leap_m"), [("tracker", (0.024, 0.0)), ("mocap", (-0.024, 0.0)), ("tracker", (0.0, 0.024))]
)
def test_one_leap_of_a_pose_is_put_right_and_no_way(device, leap_m):
    """Whichever way it leaps: what counts is how far off the step is from the other's."""
    check, found = MotionCheck(GEOMETRY), []
    for k in range(3, 200):
        given = cycle(k, at(UP), at(UP), at(UP))
        (seen,) = getattr(given, device)
        moved = replace(seen, pose=seen.pose + np.array([*leap_m, 0.0]) * (k > 100))
        found += check.update(replace(given, **{device: (moved,)}))
    assert found == []


def test_what_a_camera_invents_in_the_wall_adds_up_while_the_robot_turns():
    """In the body's axes it goes round: the sum has to go round with it."""
    rate, drift_m_s = 1.0, np.array([0.006, 0.0])
    speed, steering = inverse(GEOMETRY, np.array([0.0, 0.0, rate]))
    check, found = MotionCheck(GEOMETRY, seen=MocapTolerances(lever_m=0.0, rest_m_s=0.0)), []
    for k in range(3, 260):
        t_ns = k * PERIOD_NS
        t_s, late_ns = t_ns * 1e-9, t_ns - 25_000_000
        angle = speed / GEOMETRY.radius_m * t_s
        found += check.update(
            Measurements(
                k,
                t_ns,
                wheels=(WheelMeasurement(Stamp(t_ns, t_ns, k), angle, speed, steering, (True,) * 4),),
                tracker=(pose("tracker", late_ns, t_ns, drift_m_s * late_ns * 1e-9, rate * late_ns * 1e-9),),
                mocap=(pose("mocap", late_ns, t_ns, (0.0, 0.0), rate * late_ns * 1e-9),),
            )
        )
    assert {d.source for d in found if "motion capture" in d.message} == {"tracker"}


def doubt(source, *, confirmed=True, off=0.012, turns=False):
    return Disagreement(source, "it differs", True, confirmed, off, turns)


USED = frozenset(("tracker", "imu"))


@pytest.mark.parametrize(
    ("source", "on_wall", "spared"),
    [
        ("tracker", False, True),
        ("imu", False, True),
        ("mocap", False, True),
        ("servos", False, False),
        ("tracker", True, False),
        ("imu", True, False),
        ("mocap", True, True),
    ],
)
def test_who_can_be_left_out_depends_on_the_surface(source, on_wall, spared):
    left_out = Exclusion(USED, on_wall=on_wall)
    assert left_out.can_do_without(doubt(source)) is spared
    assert not left_out.can_do_without(doubt(source, confirmed=False))


def test_who_is_left_out_is_measured_no_more_and_widens_the_covariance():
    left_out = Exclusion(USED, on_wall=False)
    gyro = GyroMeasurement(Stamp(0, 0, 0), 0.0, 0.0, np.zeros(2))
    given = replace(cycle(5, at(UP), at(UP), at(UP)), gyro=(gyro,))
    now = Cycle(Inputs(0, 5), given)
    left_out.take(doubt("tracker"), now)
    assert (now.events[0].source, now.inflation) == ("tracker", (0.012, 0.0))
    assert "left out" in now.events[0].message
    assert left_out.without_excluded(given) == replace(given, tracker=())
    now = Cycle(Inputs(0, 6), given)
    left_out.take(doubt("imu", off=0.1, turns=True), now)
    assert now.inflation == (0.0, 0.1)
    assert left_out.without_excluded(given) == replace(given, tracker=(), gyro=())
    now = Cycle(Inputs(0, 7), given)
    left_out.take(doubt("mocap"), now)
    assert now.inflation == (0.0, 0.0)
    left_out.reset()
    assert left_out.without_excluded(given) is given
    assert "tracker" not in left_out


class Doubts:
    """Says of each cycle what it was given."""

    def __init__(self, *found):
        self.found = found

    def reset(self):
        pass

    def update(self, measurements):
        return self.found


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (doubt("servos"), True),
        (replace(doubt("mocap", confirmed=False), against="servos"), True),
        (replace(doubt("mocap"), against="servos"), False),
        (replace(doubt("tracker", confirmed=False), against="imu"), False),
    ],
)
def test_what_holds_the_robot_is_named_wherever_it_may_be_the_robot_that_slides(given, named):
    checks = Checks(motion=Doubts(given), needs_camera=True, holders=HOLDERS)
    with pytest.raises(SafetyStop, match="it differs") as stop:
        Supervised(SafetyLimits(stale_s={}), checks=checks).check(Inputs(0, 0), Measurements(0, 0))
    assert str(stop.value).endswith("it differs; if it slides, look at the fan and the propellers") is named
    assert (set(stop.value.suspects) >= set(HOLDERS)) is named


@pytest.mark.parametrize(
    ("given", "suspects"),
    [
        (doubt("servos"), {"servos", "adhesion", "thrust"}),
        (replace(doubt("tracker"), against="servos"), {"tracker"}),
        (replace(doubt("tracker", confirmed=False), against="imu"), {"tracker", "imu"}),
    ],
)
def test_wheels_that_tell_another_way_than_others_are_not_suspected_alone(given, suspects):
    checks = Checks(motion=Doubts(replace(given, grave=False)), holders=HOLDERS)
    for on_wall in (True, False):
        watching = Supervised(SafetyLimits(stale_s={}, on_wall=on_wall), checks=checks)
        (event,) = watching.check(Inputs(0, 0), Measurements(0, 0))
        assert set(event.suspects) == (suspects if on_wall else suspects - set(HOLDERS))


@pytest.mark.parametrize(("axis", "share"), [(1.0, 0.1), (1j, 0.05)])
def test_shares_of_the_way_are_taken_off_alike_on_both_sides(axis, share):
    for off in (0.3, -0.3):
        total = Sum(CAMERA, WHEELS, 1.0, 2.0)
        total.add(0, 1.0 + off * axis, 1.0, 0.0, way=(0.1, 0.05))
        assert total.size == pytest.approx(0.3 - share)


def test_half_a_second_after_a_leap_another_may_be_put_right():
    leap = Relocalisation()
    reported = [leap.jumped(round(t_s * 1e9), 0.1, 0.0) for t_s in (1.0, 1.4, 1.95)]
    assert reported == [True, False, True]


def slid(sees_from):
    """The robot slides by 8 mm before the camera's first pose, or while it looks."""

    def down(t_s):
        return np.array([-0.008 * np.clip((t_s - 0.1) / 0.06, 0.0, 1.0), 0.0])

    check, found = MotionCheck(GEOMETRY), []
    for k in range(3, 60):
        given = cycle(k, at(0.0 * UP), down, down)
        found += check.update(given if k >= sees_from else replace(given, tracker=()))
    return found


def test_a_slide_that_only_motion_capture_saw_is_unseen_and_one_that_the_camera_saw_is_not():
    late, early = slid(20), slid(3)
    assert [(d.source, d.unseen, d.grave) for d in late] == [("mocap", True, False)]
    assert late[0].off == pytest.approx(0.008, abs=0.0015)
    assert early
    assert not any(d.unseen for d in early)


@pytest.mark.parametrize(("unseen", "inflated_m"), [(True, 0.008), (False, 0.0)])
def test_an_unseen_slide_widens_the_covariance(unseen, inflated_m):
    reported = replace(
        doubt("mocap", confirmed=False, off=0.008), grave=False, against="servos", unseen=unseen
    )
    checks = Checks(motion=Doubts(reported), needs_camera=True, holders=HOLDERS)
    supervisor = Supervised(SafetyLimits(stale_s={}), checks=checks)
    (event,) = supervisor.check(Inputs(0, 0), Measurements(0, 0))
    assert supervisor.inflation == (inflated_m, 0.0)
    assert set(event.suspects) == {"mocap", "servos", *HOLDERS}


def test_two_that_contradict_each_other_are_both_in_doubt_until_others_agree_against_one():
    says, cycles = Doubts(), iter(range(100))
    watching = Supervised(SafetyLimits(stale_s={}), checks=Checks(motion=says))

    def heard(*doubts):
        says.found, k = doubts, next(cycles)
        watching.check(Inputs(k, k * PERIOD_NS), Measurements(k, k * PERIOD_NS))
        return watching.doubted

    open_question = Disagreement("tracker", "they differ", False, against="mocap")
    assert heard(open_question) == {"tracker": False, "mocap": False}
    assert heard(Disagreement("tracker", "it differs", False, confirmed=True, against="mocap")) == {
        "tracker": True
    }
    assert heard(open_question)["tracker"]
    watching.reset()
    assert watching.doubted == {}


@pytest.mark.parametrize(
    ("seen", "captured", "mocap", "agreed"),
    [
        (UP, UP, True, {"tracker", "servos", "mocap"}),
        (UP, UP, False, {"tracker", "servos"}),
        (0.0 * UP, UP, True, {"servos", "mocap"}),
        (0.0 * UP, UP, False, set()),
        (UP, 0.0 * UP, True, {"tracker", "servos"}),
    ],
)
def test_a_sensor_that_moves_as_another_agrees(seen, captured, mocap, agreed):
    check = MotionCheck(GEOMETRY)
    watching = Supervised(SafetyLimits(stale_s={}), checks=Checks(motion=check))
    for k in range(3, 90):
        check.update(cycle(k, at(UP), at(seen), at(captured), mocap=mocap))
    assert check.agreed == set(), "0.1 m it takes"
    for k in range(90, 250):
        check.update(cycle(k, at(UP), at(seen), at(captured), mocap=mocap))
    assert check.agreed == agreed
    assert watching.agreed == check.agreed
    check.leave_out("servos")
    assert "servos" not in check.agreed
    check.reset()
    assert check.agreed == set()
    assert Supervised(SafetyLimits(stale_s={})).agreed == set()


def test_a_camera_beside_motion_capture_is_grave_ten_millimetres_beyond_what_it_may_differ_by():
    check, grave_s = MotionCheck(GEOMETRY), None
    for k in range(3, 100):
        given = replace(cycle(k, at(UP), at(0.5 * UP), at(UP)), wheels=())
        if any(d.grave for d in check.update(given)):
            grave_s = (k - 3) * PERIOD_NS * 1e-9
            break
    assert grave_s is not None
    assert 0.009 < (0.05 - 0.004) * grave_s < 0.015


def test_a_step_is_compared_once_and_only_where_another_sensor_looked_too():
    check = MocapAgreement(WheelTrack(GEOMETRY), MocapTolerances(), creep=0.0)
    compared = []
    for k in range(100, 130):
        t_ns = k * PERIOD_NS
        one = (pose("mocap", t_ns, t_ns, (0.0, 0.0)),)
        check.take(one if k >= 110 else (), one)
        compared.append(check.compare())
    assert not any(compared[:11]), "one pose of the camera is no way yet"
    assert 2 <= sum(compared) <= 4, "20 cycles are four steps at most"
    check.reset()
    assert check.compare() is False


@pytest.mark.parametrize(("slip", "left"), [(0.0, 0.0), (0.03, 0.0), (0.1, 0.04)])
def test_what_wheels_are_off_counts_without_what_they_may_creep(slip, left):
    """Climbing: 6 % of the way are creep, what is beyond is an error of the wheels."""
    check = MotionCheck(GEOMETRY, seen=MocapTolerances(slipped_stop_m=1.0))
    for k in range(3, 103):
        check.update(cycle(k, at(UP), at((1.0 - slip) * UP), at((1.0 - slip) * UP)))
    way_m = abs(check.capture.ways()[1])
    camera, wheels = check.capture.errors()
    assert way_m > 0.08
    assert wheels.real == pytest.approx(left * way_m, abs=1e-6)
    assert abs(wheels.imag) + abs(camera) < 1e-6
