"""Alignment undoes mounts, signs and zeros; the supervisor stops what must not go on."""

import math
from dataclasses import replace

import numpy as np
import pytest
from supervised import Supervised

from hil.bench.loop_settings import checks, geometry_of
from hil.config.loading import load_bench
from hil.core.errors import ConfigError, SafetyStop
from hil.core.geometry import quat_conjugate, quat_from_rotvec, quat_from_yaw, quat_multiply, quat_rotate
from hil.core.signals import (
    ImuSample,
    Inputs,
    MocapSample,
    Reference,
    RobotState,
    ServoSample,
    Stamp,
    Status,
    TrackerSample,
    WheelSetpoint,
)
from hil.loop.alignment import Alignment, AlignmentParameters
from hil.loop.pose_alignment import AT_ORIGIN, Mount, PoseAlignment
from hil.loop.safety_limits import Checks, SafetyLimits

STAMP = Stamp(0, 0, 0)

IMU, TRACKER = {"imu": 0.5}, {"tracker": 2.0}


def servo_sample(position, status=(Status.OK,) * 8, alert=(0,) * 8):
    return ServoSample(STAMP, np.asarray(position, float), np.zeros(8), np.zeros(8), status, alert)


def state(pose=(0, 0, 0)):
    return RobotState(0, np.asarray(pose, float), np.zeros(3), np.eye(6))


def test_servo_goals_read_back_as_the_setpoint_they_came_from():
    alignment = Alignment(AlignmentParameters((1, -1, 1, -1), (-1, 1, 1, -1), (0.01, -0.02, 0.03, 0.04)))
    setpoint = WheelSetpoint(np.array([1.0, 2, 3, 4]), np.array([0.1, -0.2, 0.3, 1.0]))
    command = alignment.to_servos(setpoint)
    sample = servo_sample(np.r_[command.drive_velocity_rad_s, command.steer_position_rad])
    wheels = alignment.measure(Inputs(0, 0, servos=(sample,))).wheels[0]
    np.testing.assert_allclose(wheels.wheel_angle_rad, setpoint.wheel_rate_rad_s)
    np.testing.assert_allclose(wheels.steering_rad, setpoint.steering_rad, atol=1e-15)


@pytest.mark.parametrize("silent", [0, 3, 6])
def test_a_wheel_with_a_silent_servo_is_not_valid_and_the_others_are(silent):
    status = [Status.OK] * 8
    status[silent] = Status.TIMEOUT
    wheels = Alignment(AlignmentParameters()).measure(
        Inputs(0, 0, servos=(servo_sample(np.zeros(8), tuple(status)),))
    )
    assert wheels.wheels[0].valid == tuple(wheel != silent % 4 for wheel in range(4))


@pytest.mark.parametrize("scale", [1.0, 1.04, 0.97])
@pytest.mark.parametrize("attitude", [[0.0, 0.0, 0.4], [0.0, -math.pi / 2, 0.0], [0.3, 1.2, -2.0]])
def test_tracker_mount_scale_and_start_frame_cancel(attitude, scale):
    """A camera bolted to a body that moves in its own plane gives the body's planar pose.

    `scale` is the way that it reports over the true way, lever included: the alignment inverts it.
    """
    mount = Mount((0.1489, 0.0092, 0.0666), tuple(quat_from_rotvec([0.02, -0.1, 0.3])))
    alignment = Alignment(AlignmentParameters(tracker=mount, tracker_scale=scale))
    wall_in_world = quat_from_rotvec(attitude)
    yaw = 0.0
    for k in range(40):
        body_m = np.array([0.1 * k, -0.05 * k, 0.0])
        yaw = 0.2 * k
        turn = quat_from_yaw(yaw)
        camera_m = body_m + quat_rotate(turn, mount.position_m)
        camera_wxyz = quat_multiply(wall_in_world, quat_multiply(turn, mount.rotation_wxyz))
        sample = TrackerSample(
            Stamp(k, k, k),
            scale * quat_rotate(wall_in_world, camera_m),
            camera_wxyz,
            np.zeros(3),
            np.zeros(3),
            3,
        )
        (measured,) = alignment.measure(Inputs(k, k, tracker=(sample,))).tracker
        np.testing.assert_allclose(measured.pose, [*body_m[:2], yaw], atol=1e-9)


@pytest.mark.parametrize("turned", [0.0, 0.7, -2.0])
def test_a_camera_that_started_again_has_another_frame_and_reports_the_same_motion(turned):
    """Looking up the wall it finds down by gravity, but begins at any angle about it."""
    mount = Mount((0.15, 0.01, 0.07), tuple(quat_from_rotvec([0.02, -0.1, 0.3])))
    alignment = Alignment(AlignmentParameters(tracker=mount))
    upright = quat_from_rotvec([0.0, -math.pi / 2, 0.0])
    frames = [upright, quat_multiply(quat_from_yaw(turned), upright)]
    measured = []
    for k in range(20):
        new, state = k >= 10, Status.RESET if k == 10 else Status.JUMP if k == 11 else Status.OK
        turn = quat_from_yaw(0.02 * k)
        camera_m = np.array([0.01, -0.02, 0.0]) * k + quat_rotate(turn, mount.position_m)
        attitude = quat_multiply(frames[new], quat_multiply(turn, mount.rotation_wxyz))
        sample = TrackerSample(
            Stamp(k, k, k), quat_rotate(frames[new], camera_m), attitude, np.zeros(3), np.zeros(3), 3, state
        )
        measured += alignment.measure(Inputs(k, k, tracker=(sample,))).tracker
    assert [m.valid for m in measured] == [True] * 10 + [False] + [True] * 8
    begin, end = measured[11].pose, measured[-1].pose
    back = quat_rotate(quat_from_yaw(-0.02 * 12), np.array([0.01, -0.02, 0.0]) * 7)
    np.testing.assert_allclose(end - begin, [*back[:2], 0.02 * 7], atol=1e-9)


def test_a_reset_forgets_where_the_camera_began():
    alignment = Alignment(AlignmentParameters())
    one = np.array([1.0, 0.0, 0.0, 0.0])

    def seen(k):
        sample = TrackerSample(Stamp(k, k, k), np.array([k, 0.0, 0.0]), one, np.zeros(3), np.zeros(3), 3)
        (measured,) = alignment.measure(Inputs(k, k, tracker=(sample,))).tracker
        return measured.pose.tolist()

    assert [seen(1), seen(3)] == [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    alignment.reset()
    assert [seen(4), seen(5)] == [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]


@pytest.mark.parametrize("heading", [0.0, 0.2, -1.0, 3.0])
def test_gravity_in_the_wall_plane_gives_heading_through_the_mount(heading):
    mount = Mount(rotation_wxyz=tuple(quat_from_rotvec([0.3, 0.2, -1.0])))
    up_body = quat_rotate(quat_from_yaw(-heading), [9.81, 0, 0])
    rate_body = np.array([0.0, 0.0, 0.7])
    back = quat_conjugate(mount.rotation_wxyz)
    sample = ImuSample(
        STAMP,
        np.array([1.0, 0, 0, 0]),
        quat_rotate(back, rate_body),
        np.zeros(3),
        quat_rotate(back, up_body),
        (3, 3, 3, 3),
    )
    on_wall = Alignment(AlignmentParameters(imu=mount)).measure(Inputs(0, 0, imu=(sample,)))
    assert on_wall.gyro[0].gravity_heading_rad == pytest.approx(heading, abs=1e-12)
    assert on_wall.gyro[0].yaw_rate_rad_s == pytest.approx(0.7)
    floor = Alignment(AlignmentParameters(imu=mount, on_wall=False)).measure(Inputs(0, 0, imu=(sample,)))
    assert math.isnan(floor.gyro[0].gravity_heading_rad)


@pytest.mark.parametrize(("share", "known"), [(0.09, False), (0.11, True)])
@pytest.mark.parametrize("heading", [0.0, math.pi / 2, 2.0])
def test_gravity_gives_a_heading_only_where_enough_of_it_lies_in_the_plane(heading, share, known):
    """On a surface that is almost level it would be noise."""
    up = 9.81 * np.array(
        [share * math.cos(heading), -share * math.sin(heading), math.sqrt(1.0 - share * share)]
    )
    sample = ImuSample(STAMP, np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3), up, (3, 3, 3, 3))
    gyro = Alignment(AlignmentParameters()).measure(Inputs(0, 0, imu=(sample,))).gyro[0]
    assert math.isfinite(gyro.gravity_heading_rad) is known
    if known:
        assert gyro.gravity_heading_rad == pytest.approx(heading, abs=1e-9)


def test_alignment_wants_four_wheels():
    with pytest.raises(ConfigError, match="steer_zero_rad"):
        Alignment(AlignmentParameters(steer_zero_rad=(0.0, 0.0)))


def test_a_servo_that_stays_silent_stops_the_robot_but_one_gap_does_not():
    supervisor = Supervised(SafetyLimits())
    answers, silent = servo_sample(np.zeros(8)), servo_sample(np.full(8, np.nan), (Status.TIMEOUT,) * 8)
    reads = [answers, *[silent] * 9, answers, *[silent] * 10]
    for k, sample in enumerate(reads):
        supervisor.check(Inputs(k, 10_000_000 * k, servos=(sample,)))
    with pytest.raises(SafetyStop, match="stale_servos"):
        supervisor.check(Inputs(21, 200_000_001, servos=(silent,)))


def test_who_is_driven_does_not_wait_for_a_sensor_that_is_to_come_back():
    """Samples that cannot be used are judged by their driver; here it is nothing at all that counts."""
    good = ImuSample(STAMP, np.zeros(4), np.zeros(3), np.zeros(3), np.zeros(3), (3, 3, 3, 3))
    bad = replace(good, status=Status.TIMEOUT)
    driven = Supervised(SafetyLimits(stale_s=IMU), checks=Checks(lost_after_s={"imu": 3.1}))
    watching = Supervised(SafetyLimits(stale_s=IMU))
    for supervisor in (driven, watching):
        supervisor.check(Inputs(0, 0, imu=(good,)))
        for k in range(1, 18):
            supervisor.check(Inputs(k, k * 400_000_000, imu=(bad,) if k <= 10 else ()))
    watching.check(Inputs(18, 7_200_000_000))
    with pytest.raises(SafetyStop, match=r"nothing from imu for 3\.2 s") as stopped:
        driven.check(Inputs(18, 7_200_000_000))
    assert stopped.value.reason == "lost_imu"


def test_a_run_that_follows_a_pose_is_one_that_does_not_wait():
    config = load_bench("emulated")
    driven, watching = (
        checks(config, geometry_of(config), follows=follows, feedback="ekf") for follows in (True, False)
    )
    assert set(driven.lost_after_s) >= {"imu", "tracker"}
    assert driven.lost_after_s["imu"] > config.imu.fail_after_s
    assert watching.lost_after_s == {}


def test_limits_scale_all_wheels_alike():
    supervisor = Supervised(SafetyLimits(wheel_rate_limit_rad_s=2.0))
    out = supervisor.limit(WheelSetpoint(np.array([4.0, 2, -1, 0]), np.zeros(4)))
    np.testing.assert_allclose(out.wheel_rate_rad_s, [2.0, 1, -0.5, 0])


def imu_inputs(cycle, force, status=Status.OK):
    stamp = Stamp(cycle * 10_000_000, cycle * 10_000_000, cycle)
    sample = ImuSample(
        stamp,
        np.array([1.0, 0, 0, 0]),
        np.zeros(3),
        np.array([force - 9.81, 0, 0]),
        np.array([9.81, 0, 0]),
        (3, 3, 3, 3),
        status,
    )
    return Inputs(cycle, stamp.t_ns, imu=(sample,))


def seen_at(cycle, speed):
    """A camera that sees so much speed."""
    stamp = Stamp(cycle * 10_000_000, cycle * 10_000_000, cycle)
    velocity = np.array([0.0, -speed, 0.0])
    return TrackerSample(stamp, np.zeros(3), np.array([1.0, 0, 0, 0]), velocity, np.zeros(3), 3)


def with_everything(cycle, *, light=False, speed=0.0, alert=0):
    inputs = imu_inputs(cycle, 0.2 if light else 9.81)
    return replace(
        inputs,
        tracker=(seen_at(cycle, speed),),
        servos=(servo_sample(np.zeros(8), alert=(alert, *(0,) * 7)),),
    )


def test_what_comes_together_is_named_together_the_gravest_first():
    supervisor = Supervised(SafetyLimits(stale_s={"servos": 0.1, **IMU, **TRACKER}))
    for cycle in range(2):
        supervisor.check(with_everything(cycle, light=True, speed=0.9))
    with pytest.raises(SafetyStop) as stop:
        supervisor.check(with_everything(2, light=True, speed=0.9, alert=0x20))
    assert stop.value.reason == "adhesion"
    assert all(word in str(stop.value) for word in ("also sliding", "also hardware_error", "drive_FL"))


def test_the_guard_names_heading_and_distance_together():
    reference = Reference(0.0, np.zeros(3), np.zeros(3), np.zeros(3))
    with pytest.raises(SafetyStop) as stop:
        Supervised(SafetyLimits()).guard(state((0.6, 0, 0.3)), reference)
    assert stop.value.reason == "heading"
    assert "also tracking" in str(stop.value)


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        ((0, 0, 0.2617), None),
        ((0, 0, 2 * math.pi - 0.2617), None),
        ((0, 0, -0.2619), "heading"),
        ((0.4999, 0, 0), None),
        ((0, -0.5001, 0), "tracking"),
    ],
)
def test_the_guards_limits_are_where_they_are_said_to_be(pose, reason):
    reference = Reference(0.0, np.zeros(3), np.zeros(3), np.zeros(3))
    supervisor = Supervised(SafetyLimits(heading_limit_rad=0.2618))
    if reason is None:
        supervisor.guard(state(pose), reference)
        return
    with pytest.raises(SafetyStop) as stop:
        supervisor.guard(state(pose), reference)
    assert stop.value.reason == reason


def test_the_floor_has_no_heading_limit():
    Supervised(SafetyLimits(on_wall=False)).guard(state((0, 0, 3.0)), None)  # no stop


def test_drives_and_steers_are_not_turned_round_unless_it_is_said():
    """The signs of a bench that says nothing: a positive servo angle is a positive wheel angle."""
    alignment = Alignment(AlignmentParameters())
    command = alignment.to_servos(WheelSetpoint(np.full(4, 2.0), np.full(4, 0.3)))
    np.testing.assert_array_equal(command.drive_velocity_rad_s, 2.0)
    np.testing.assert_array_equal(command.steer_position_rad, 0.3)
    sample = servo_sample(np.r_[np.full(4, 1.5), np.full(4, 0.2)])
    sample = replace(sample, velocity_rad_s=np.full(8, 0.7))
    (wheels,) = alignment.measure(Inputs(0, 0, servos=(sample,))).wheels
    np.testing.assert_array_equal(wheels.wheel_angle_rad, 1.5)
    np.testing.assert_array_equal(wheels.wheel_rate_rad_s, 0.7)
    np.testing.assert_array_equal(wheels.steering_rad, 0.2)


ABSURD = [1.0e3, 1e12, -1e154, 1e200, 1.7e308, math.inf, math.nan]
PLACES = [(place, value) for place in ("position_m", "quaternion_wxyz") for value in ABSURD]


@pytest.mark.parametrize(("place", "value"), [*PLACES, ("quaternion_wxyz", 0.5), ("quaternion_wxyz", 1.1)])
def test_an_absurd_camera_or_capture_pose_leaves_no_trace(place, value):
    """One bad sample, and every later heading is as if it had not been."""
    alignment = Alignment(AlignmentParameters())
    for cycle in range(5):
        stamp, angle = Stamp(cycle, cycle, cycle), 0.1 * cycle
        good = {"position_m": np.array([0.1, 0, 0]), "quaternion_wxyz": quat_from_yaw(angle)}
        if cycle == 2:
            spoilt = good[place].copy()
            spoilt[0] = value
            good[place] = spoilt
        camera = TrackerSample(
            stamp, velocity_m_s=np.zeros(3), angular_velocity_rad_s=np.zeros(3), confidence=3, **good
        )
        capture = MocapSample(stamp, tracking_valid=True, latency_s=0.0, marker_error_m=0.0, **good)
        measured = alignment.measure(Inputs(cycle, cycle, tracker=(camera,), mocap=(capture,)))
        assert len(measured.tracker) == (0 if cycle == 2 else 1)
        assert measured.mocap[0].valid == (cycle != 2)
        if cycle != 2:
            assert measured.tracker[0].pose[2] == pytest.approx(angle)
            assert measured.mocap[0].pose[2] == pytest.approx(angle)


def test_an_absurd_gravity_leaves_no_trace():
    """Under a mount that turns it, it overflows to infinity in one axis and to no number in the other."""
    mount = Mount(rotation_wxyz=tuple(quat_from_rotvec([0.3, 0.2, -1.0]).tolist()))
    alignment = Alignment(AlignmentParameters(imu=mount))
    for cycle in range(4):
        up = np.array([9.81, 0, 0]) if cycle != 1 else np.full(3, 1.7e308)
        sample = ImuSample(
            Stamp(cycle, cycle, cycle), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3), up, (3, 3, 3, 3)
        )
        (gyro,) = alignment.measure(Inputs(cycle, cycle, imu=(sample,))).gyro
        assert math.isnan(gyro.gravity_heading_rad) == (cycle == 1)


def test_a_camera_at_the_origin_reports_the_bodys_own_way_and_motion_capture_its_quality():
    alignment = PoseAlignment(AT_ORIGIN, 1.0)
    one, none = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    for x_m in (0.0, 0.2):
        turn = np.array(quat_from_yaw(2.0 * x_m))
        camera = TrackerSample(STAMP, np.array([x_m, -x_m, 0.0]), turn, none, none, 3)
        (measured,), _ = alignment.measure(Inputs(0, 0, tracker=(camera,)))
    np.testing.assert_allclose(measured.pose, [0.2, -0.2, 0.4], atol=1e-12)
    for tracked, quality in ((True, 3), (False, 0)):
        seen = MocapSample(STAMP, np.array([0.1, 0.2, 0.0]), one, tracked, 0.0, 0.0)
        _, (found,) = alignment.measure(Inputs(0, 0, mocap=(seen,)))
        assert (found.valid, found.quality) == (tracked, quality)


def test_a_camera_of_which_only_the_place_is_named_looks_along_the_bodys_axes():
    """It goes round with a body that turns in place."""
    alignment, none = PoseAlignment(Mount((0.1, 0.05, 0.0)), 1.0), np.zeros(3)
    for yaw in (0.0, 0.4, 0.8):
        turn = np.array(quat_from_yaw(yaw))
        camera = TrackerSample(STAMP, quat_rotate(turn, (0.1, 0.05, 0.0)), turn, none, none, 3)
        (measured,), _ = alignment.measure(Inputs(0, 0, tracker=(camera,)))
        np.testing.assert_allclose(measured.pose, [0.0, 0.0, yaw], atol=1e-12)
