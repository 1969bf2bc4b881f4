"""Camera, wheels and gyro that measure one motion are left alone; one that reports another is named."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.core.signals import GyroMeasurement, Measurements, PoseMeasurement, Stamp, WheelMeasurement
from hil.loop.checks.dead_reckoning import GyroTrack, WheelTrack
from hil.loop.checks.motion_agreement import MotionCheck, Tolerances
from hil.robot.kinematics import WheelGeometry, inverse

GEOMETRY = WheelGeometry.nominal()
PERIOD_NS, LATE_NS = 10_000_000, 25_000_000


class Robot:
    """Drives a constant twist per second of time; what each sensor reports of it can be changed.

    Args:
        twist: (v_x, v_y, omega) of the wheels.
        camera: the twist that the camera sees, by default the same.
        gyro: the rate that the gyro feels, by default the same.
        noise_m: of a camera pose.
    """

    def __init__(self, twist, *, camera=None, gyro=None, noise_m=0.0):
        self.twist, self.camera = np.array(twist, float), np.array(twist if camera is None else camera, float)
        self.gyro = self.twist[2] if gyro is None else gyro
        self.rng, self.noise_m = np.random.default_rng(0), noise_m
        self.turned = np.zeros(4)

    def pose(self, t_s):
        """Of the camera's twist, from the start on."""
        vx, vy, w = self.camera
        if w == 0.0:
            return np.array([vx * t_s, vy * t_s, 0.0])
        s, c = math.sin(w * t_s), 1.0 - math.cos(w * t_s)
        return np.array([(vx * s - vy * c) / w, (vx * c + vy * s) / w, w * t_s])

    def cycle(self, k, **camera):
        t_ns = k * PERIOD_NS
        speed, steering = inverse(GEOMETRY, self.twist)
        angles = speed / GEOMETRY.radius_m * t_ns * 1e-9
        stamp, late = Stamp(t_ns, t_ns, k), Stamp(t_ns - LATE_NS, t_ns, k)
        pose = self.pose(late.t_ns * 1e-9) + self.rng.normal(0.0, self.noise_m, 3) * [1.0, 1.0, 1.0]
        pose = camera.pop("pose", pose)
        valid = camera.pop("valid", True)
        return Measurements(
            k,
            t_ns,
            wheels=(WheelMeasurement(stamp, angles, speed, steering, (True,) * 4),),
            gyro=(GyroMeasurement(stamp, self.gyro, math.nan, np.zeros(2)),),
            tracker=(PoseMeasurement(late, "tracker", pose, 3, valid),),
        )


def doubts(robot, cycles=400, check=None):
    check = check if check is not None else MotionCheck(GEOMETRY)
    return [(k, d) for k in range(cycles) for d in check.update(robot.cycle(k))]


MOTIONS = [(0.1, 0, 0), (0, -0.1, 0), (0.07, 0.07, 0.2), (0, 0, 0.8), (0, 0, 0), (-0.1, 0.02, -0.5)]


@pytest.mark.parametrize("twist", MOTIONS)
def test_one_motion_leaves_nothing_to_doubt(twist):
    check = MotionCheck(GEOMETRY, Tolerances(path=0.0, creep=0.0, lever_m=0.0, turn=0.0, turn_rad_m=0.0))
    assert doubts(Robot(twist, noise_m=0.0005), check=check) == []


@pytest.mark.parametrize("twist", MOTIONS[:3])
@pytest.mark.parametrize("scale", [0.0, 0.3, 0.5, 2.0])
def test_a_camera_of_another_scale_is_reported_and_then_grave_within_centimetres(twist, scale):
    twist = np.array(twist)
    seen = doubts(Robot(twist, camera=twist * [scale, scale, 1.0]))
    first, grave = seen[0], next(d for d in seen if d[1].grave)
    assert not first[1].grave
    assert first[1].source == "tracker"
    assert first[0] < grave[0]
    rolled_m = np.hypot(twist[0], twist[1]) * (grave[0] * PERIOD_NS - LATE_NS) * 1e-9
    assert 0.010 < abs(1.0 - scale) * rolled_m < 0.024


@pytest.mark.parametrize(
    ("share", "on_wall", "honest"),
    [
        ((-0.10, 0.0), True, True),
        ((0.0, 0.049), True, True),
        ((0.049, 0.0), True, True),
        ((-0.14, 0.0), True, False),
        ((0.08, 0.0), True, False),
        ((0.0, 0.08), True, False),
        ((-0.08, 0.0), False, False),
        ((-0.049, 0.0), False, True),
    ],
)
def test_creep_on_a_wall_takes_away_and_adds_nothing(share, on_wall, honest):
    """Climbing at 0.1 m/s for 8 s; the camera sees so much more of it, along and across."""
    robot = Robot((0.1, 0, 0), camera=(0.1 * (1.0 + share[0]), 0.1 * share[1], 0.0))
    found = doubts(robot, 800, MotionCheck(GEOMETRY, on_wall=on_wall))
    assert (found == []) is honest


def test_a_robot_that_gets_lower_across_the_wall_creeps():
    assert doubts(Robot((0, 0.1, 0), camera=(-0.008, 0.1, 0))) == []
    assert doubts(Robot((0, 0.1, 0), camera=(0.008, 0.1, 0)), 800)


@pytest.mark.parametrize(
    ("robot", "source"),
    [
        (Robot((0.05, 0, 0), gyro=0.15), "imu"),
        (Robot((0, 0, 0.4), camera=(0, 0, 0.1)), "tracker"),
        (Robot((0, 0, 0.4), camera=(0, 0, 0.7), gyro=0.7), "servos"),
    ],
)
def test_who_turns_alone_is_named(robot, source):
    found = [d for _, d in doubts(robot, 800)]
    assert any(d.grave for d in found)
    assert {d.source for d in found if d.grave} >= {source}
    assert found[0].source in (source, "tracker")


def test_wheels_and_gyro_are_compared_without_a_camera_too():
    check, robot = MotionCheck(GEOMETRY), Robot((0.05, 0, 0), gyro=0.15)
    found = [d for k in range(400) for d in check.update(replace(robot.cycle(k), tracker=()))]
    assert {d.source for d in found} <= {"imu", "servos"}
    assert any(d.grave for d in found)


def test_a_gyro_may_have_the_bias_of_its_data_sheet():
    assert doubts(Robot((0.05, 0, 0), gyro=math.radians(3.0)), 2000) == []


def run_with(robot, change, cycles=400):
    check = MotionCheck(GEOMETRY)
    return [(k, d) for k in range(cycles) for d in check.update(robot.cycle(k, **change(k)))]


def moved_by(robot, at, step_m):
    """Poses that are off by a step from a cycle on."""
    return lambda k: {
        "pose": np.add(robot.pose((k * PERIOD_NS - LATE_NS) * 1e-9), [step_m * (k >= at), 0, 0])
    }


def test_a_relocalisation_is_not_motion_but_many_are():
    robot = Robot((0.05, 0, 0))
    assert run_with(robot, moved_by(robot, 100, 0.2)) == []
    assert run_with(robot, moved_by(robot, 100, 0.021)) == []
    assert run_with(robot, moved_by(robot, 100, 0.019)) != []

    def often(k):
        return {"pose": np.array([0.05 * (k // 10), 0, 0])}

    assert any(d.grave for _, d in run_with(Robot((0, 0, 0)), often))


def test_what_is_not_valid_begins_anew():
    """Behind an invalid pose the camera's frame may be another."""
    robot = Robot((0.05, 0, 0))

    def away(k):
        pose = np.add(robot.pose((k * PERIOD_NS - LATE_NS) * 1e-9), [0.015 * (k > 100), 0, 0])
        return {"pose": pose, "valid": k != 100}

    assert run_with(robot, away) == []


def test_a_camera_that_sits_elsewhere_on_a_turning_robot_is_honest():
    """25 mm from where it is believed to be, in a turn at 0.8 rad/s."""
    assert doubts(Robot((0, 0, 0.8), camera=(0, 0.02, 0.8)), 800) == []
    assert doubts(Robot((0, 0, 0.8), camera=(0, 0.05, 0.8)), 800)


def test_a_slow_slide_is_summed_in_axes_that_turn_with_the_robot():
    """3 mm/s in one direction of the wall, while the body turns round under it."""
    check = MotionCheck(GEOMETRY, Tolerances(lever_m=0.0, path=0.0), on_wall=False)
    robot, found = Robot((0, 0, 0.8)), []
    for k in range(1000):
        t_s = (k * PERIOD_NS - LATE_NS) * 1e-9
        found += check.update(robot.cycle(k, pose=robot.pose(t_s) + np.array([0.003 * t_s, 0, 0])))
    assert any(d.grave for d in found)


def test_wheels_that_contradict_each_other_prove_nothing():
    """One wheel turns alone, the robot stands: least squares would have it move and turn."""
    check, robot, found = MotionCheck(GEOMETRY), Robot((0, 0, 0)), []
    for k in range(600):
        cycle = robot.cycle(k)
        wheel = replace(cycle.wheels[0], wheel_angle_rad=np.array([0.03 * k, 0, 0, 0]))
        found += check.update(replace(cycle, wheels=(wheel,)))
    assert found == []


def test_reset_forgets_what_was_doubted():
    check, robot = MotionCheck(GEOMETRY), Robot((0.1, 0, 0), camera=(0, 0, 0))
    first = doubts(robot, 60, check)
    check.reset()
    assert doubts(robot, 60, check) == first != []


def wheels(t_ns, angle, steering=0.0, valid=True):
    return WheelMeasurement(
        Stamp(t_ns, t_ns, 0), np.full(4, angle), np.zeros(4), np.full(4, steering), (valid,) * 4
    )


def test_the_wheels_way_is_known_between_samples_and_bridges_what_is_missing():
    track = WheelTrack(GEOMETRY)
    for k in range(11):
        track.take(wheels(k * 30_000_000, 0.1 * k, valid=k not in (3, 4)))
    place, heading, rolled, contradiction = track.at(225_000_000)
    assert place == pytest.approx(0.75 * GEOMETRY.radius_m[0])
    assert (heading, contradiction) == (pytest.approx(0.0, abs=1e-15), pytest.approx(0.0, abs=1e-12))
    assert rolled == pytest.approx(0.75 * GEOMETRY.radius_m[0])
    assert track.at(300_000_001) is None
    assert track.at(-1) is None


def test_wheels_that_contradict_each_other_say_by_how_much():
    track = WheelTrack(GEOMETRY)
    track.take(wheels(0, 0.0))
    track.take(
        WheelMeasurement(
            Stamp(30_000_000, 0, 1), np.array([0.1, 0, 0, 0]), np.zeros(4), np.zeros(4), (True,) * 4
        )
    )
    assert track.at(30_000_000)[3].real > 0.4 * 0.1 * GEOMETRY.radius_m[0]


def test_the_way_of_an_arc_is_that_of_an_arc_whatever_the_steering_zeros():
    zeros = np.array([0.1, -0.2, 0.3, 0.0])
    geometry = WheelGeometry(GEOMETRY.x_m, GEOMETRY.y_m, GEOMETRY.radius_m, zeros)
    track, robot = WheelTrack(geometry), Robot((0.1, 0.02, 1.0))
    speed, steering = inverse(geometry, robot.twist)
    for k in range(51):
        t_ns = k * 30_000_000
        angles = speed / geometry.radius_m * t_ns * 1e-9
        track.take(WheelMeasurement(Stamp(t_ns, t_ns, k), angles, speed, steering, (True,) * 4))
    place, heading, _, contradiction = track.at(1_500_000_000)
    x_m, y_m, turned = robot.pose(1.5)
    assert abs(place - complex(x_m, y_m)) < 1e-5
    assert heading == pytest.approx(turned)
    assert contradiction == pytest.approx(0.0, abs=1e-12)


def test_a_leap_of_a_wheel_is_no_way():
    track = WheelTrack(GEOMETRY)
    for k in range(10):
        track.take(wheels(k * 30_000_000, 0.02 * k + 0.5 * (k >= 5)))
    assert track.at(135_000_000) is None
    assert track.at(270_000_000)[0].real == pytest.approx(0.16 * GEOMETRY.radius_m[0])


def test_the_gyros_angle_ends_at_a_gap():
    track = GyroTrack()
    for t_ms in (0, 10, 20, 200, 210):
        track.take(GyroMeasurement(Stamp(t_ms * 1_000_000, 0, 0), 2.0, math.nan, np.zeros(2)))
    assert not track.covers(20_000_000)
    assert track.covers(200_000_000)
    assert track.at(205_000_000)[0] == pytest.approx(0.01)


@pytest.mark.parametrize(("drift_rad_s", "honest"), [(0.0025, True), (-0.0025, True), (0.006, False)])
def test_the_heading_of_a_camera_may_drift_slowly_while_nothing_moves(drift_rad_s, honest):
    assert (doubts(Robot((0, 0, 0), camera=(0, 0, drift_rad_s), gyro=0.0), 2200) == []) is honest


@pytest.mark.parametrize("rate", [0.5, -0.5])
@pytest.mark.parametrize(("scale", "honest"), [(1.025, True), (1.06, False)])
def test_the_scale_of_a_gyro_may_be_off_by_as_much_in_either_direction(rate, scale, honest):
    """A gyro without bias: its scale alone counts."""
    check = MotionCheck(GEOMETRY, Tolerances(gyro_rad_s=0.0, turn=0.0))
    assert (doubts(Robot((0, 0, rate), gyro=scale * rate), 600, check) == []) is honest
