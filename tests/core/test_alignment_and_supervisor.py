"""Alignment undoes mounts, signs and zeros; the supervisor stops what must not go on."""

import math

import numpy as np
import pytest

from hil.alignment import Alignment, AlignmentParameters, Mount
from hil.errors import ConfigError, SafetyStop
from hil.geometry import quat_conjugate, quat_from_rotvec, quat_from_yaw, quat_multiply, quat_rotate
from hil.signals import (
    ImuSample,
    Inputs,
    Reference,
    RobotState,
    ServoSample,
    Stamp,
    Status,
    TrackerSample,
    WheelSetpoint,
)
from hil.supervisor import SafetyLimits, Supervisor

STAMP = Stamp(0, 0, 0)


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


def test_a_wheel_with_a_silent_servo_is_not_valid():
    status = [Status.OK] * 8
    status[5] = Status.TIMEOUT
    wheels = Alignment(AlignmentParameters()).measure(
        Inputs(0, 0, servos=(servo_sample(np.zeros(8), tuple(status)),))
    )
    assert wheels.wheels[0].valid == (True, False, True, True)


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
            Stamp(k, k, k), scale * quat_rotate(wall_in_world, camera_m), camera_wxyz, np.zeros(3),
            np.zeros(3), 3,
        )  # fmt: skip
        (measured,) = alignment.measure(Inputs(k, k, tracker=(sample,))).tracker
        np.testing.assert_allclose(measured.pose, [*body_m[:2], yaw], atol=1e-9)


@pytest.mark.parametrize("heading", [0.0, 0.2, -1.0, 3.0])
def test_gravity_in_the_wall_plane_gives_heading_through_the_mount(heading):
    mount = Mount(rotation_wxyz=tuple(quat_from_rotvec([0.3, 0.2, -1.0])))
    up_body = quat_rotate(quat_from_yaw(-heading), [9.81, 0, 0])
    rate_body = np.array([0.0, 0.0, 0.7])
    back = quat_conjugate(mount.rotation_wxyz)
    sample = ImuSample(
        STAMP, np.array([1.0, 0, 0, 0]), quat_rotate(back, rate_body), np.zeros(3),
        quat_rotate(back, up_body), (3, 3, 3, 3),
    )  # fmt: skip
    on_wall = Alignment(AlignmentParameters(imu=mount)).measure(Inputs(0, 0, imu=(sample,)))
    assert on_wall.gyro[0].gravity_heading_rad == pytest.approx(heading, abs=1e-12)
    assert on_wall.gyro[0].yaw_rate_rad_s == pytest.approx(0.7)
    floor = Alignment(AlignmentParameters(imu=mount, on_wall=False)).measure(Inputs(0, 0, imu=(sample,)))
    assert math.isnan(floor.gyro[0].gravity_heading_rad)


def test_alignment_wants_four_wheels():
    with pytest.raises(ConfigError, match="steer_zero_rad"):
        Alignment(AlignmentParameters(steer_zero_rad=(0.0, 0.0)))


def test_a_servo_that_stays_silent_stops_the_robot_but_one_gap_does_not():
    supervisor = Supervisor(SafetyLimits(servo_stale_s=0.1))
    silent = servo_sample(np.full(8, np.nan), (Status.TIMEOUT,) * 8)
    supervisor.check(Inputs(0, 0, servos=(servo_sample(np.zeros(8)),)))
    supervisor.check(Inputs(1, 90_000_000, servos=(silent,)))
    supervisor.check(Inputs(2, 100_000_000, servos=(servo_sample(np.zeros(8)),)))
    supervisor.check(Inputs(3, 200_000_000, servos=(silent,)))
    with pytest.raises(SafetyStop, match="stale_servos"):
        supervisor.check(Inputs(4, 201_000_001, servos=(silent,)))


def test_a_silent_imu_is_told_once_and_its_return_too():
    supervisor = Supervisor(SafetyLimits(imu_stale_s=0.5), watched=("imu",))
    events = [supervisor.check(Inputs(k, k * 100_000_000)) for k in range(12)]
    assert [len(e) for e in events] == [0] * 6 + [1] + [0] * 5
    good = ImuSample(STAMP, np.zeros(4), np.zeros(3), np.zeros(3), np.zeros(3), (3, 3, 3, 3))
    assert supervisor.check(Inputs(12, 1_200_000_000, imu=(good,)))[0].message == "answers again"


@pytest.mark.parametrize(
    ("pose", "reason"),
    [((0, 0, 0.27), "heading"), ((np.nan, 0, 0), "not_finite"), ((0.6, 0, 0), "tracking")],
)
def test_the_guard_names_why_it_stops(pose, reason):
    reference = Reference(0.0, np.zeros(3), np.zeros(3), np.zeros(3))
    with pytest.raises(SafetyStop) as stop:
        Supervisor(SafetyLimits()).guard(state(pose), reference)
    assert stop.value.reason == reason


def test_hardware_alert_stops():
    with pytest.raises(SafetyStop, match="alert"):
        Supervisor(SafetyLimits()).check(
            Inputs(0, 0, servos=(servo_sample(np.zeros(8), alert=(0, 4, 0, 0, 0, 0, 0, 0)),))
        )


def test_limits_scale_all_wheels_alike_and_refuse_nonsense():
    supervisor = Supervisor(SafetyLimits(wheel_rate_limit_rad_s=2.0))
    out = supervisor.limit(WheelSetpoint(np.array([4.0, 2, -1, 0]), np.zeros(4)))
    np.testing.assert_allclose(out.wheel_rate_rad_s, [2.0, 1, -0.5, 0])
    with pytest.raises(SafetyStop, match="finite"):
        supervisor.limit(WheelSetpoint(np.array([np.nan, 0, 0, 0]), np.zeros(4)))
    with pytest.raises(SafetyStop, match="steering"):
        supervisor.limit(WheelSetpoint(np.zeros(4), np.array([2.2, 0, 0, 0])))


def imu_inputs(cycle, force, status=Status.OK):
    stamp = Stamp(cycle * 10_000_000, cycle * 10_000_000, cycle)
    sample = ImuSample(
        stamp, np.array([1.0, 0, 0, 0]), np.zeros(3), np.array([force - 9.81, 0, 0]), np.array([9.81, 0, 0]),
        (3, 3, 3, 3), status,
    )  # fmt: skip
    return Inputs(cycle, stamp.t_ns, imu=(sample,))


def test_a_robot_that_feels_no_weight_has_lost_its_hold():
    supervisor = Supervisor(SafetyLimits(), watched=("imu",))
    for cycle in range(20):
        supervisor.check(imu_inputs(cycle, 9.0 + cycle % 3))
    supervisor.check(imu_inputs(20, 0.2))
    supervisor.check(imu_inputs(21, 9.8))
    supervisor.check(imu_inputs(22, 0.2))
    supervisor.check(imu_inputs(23, 0.2))
    with pytest.raises(SafetyStop, match="adhesion"):
        supervisor.check(imu_inputs(24, 0.2))
    supervisor.reset()
    for cycle in range(5):
        supervisor.check(imu_inputs(cycle, 0.2, Status.PROTOCOL))


def test_a_robot_faster_than_it_can_drive_is_sliding():
    supervisor = Supervisor(SafetyLimits(), watched=("tracker",))

    def seen(cycle, speed):
        stamp = Stamp(cycle * 10_000_000, cycle * 10_000_000, cycle)
        sample = TrackerSample(
            stamp, np.zeros(3), np.array([1.0, 0, 0, 0]), np.array([0, -speed, 0]), np.zeros(3), 3
        )
        return supervisor.check(Inputs(cycle, stamp.t_ns, tracker=(sample,)))

    for cycle in range(20):
        seen(cycle, 0.4)
    seen(20, 0.9)
    seen(21, 0.9)
    with pytest.raises(SafetyStop, match="sliding"):
        seen(22, 0.9)
