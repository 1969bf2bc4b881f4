"""Drives the plant without bus, sensors or bench: perfect joint readings, wheel commands, odometry."""

from dataclasses import replace

import numpy as np
import pytest

from hil.config.control import ControlConfig
from hil.config.robot import RobotConfig
from hil.controller import make_controller
from hil.core.clock import NS_PER_S
from hil.core.geometry import compose, se2_exp
from hil.core.signals import RobotState, Stamp, WheelMeasurement
from hil.fakes.body_interface import JointCommand
from hil.fakes.plant import WallRobot, make_plant
from hil.fakes.plant.robot import GRAVITY_M_S2
from hil.faults.fault import make_fault
from hil.faults.plan import FaultPlan
from hil.robot.kinematics import WheelGeometry, forward, inverse
from hil.robot.trajectories import line

PERIOD_NS = 10_000_000
MS_NS = 1_000_000
FLOOR = {"surface": "floor", "tilt_rad": 0.0}
X_LINE = line((0, 0, 0), (1.5, 0, 0), duration_s=30.0)
Y_LINE = line((0, 0, 0), (0, 1.5, 0), duration_s=30.0)


def build(seed=0, *, random=False, config=None, **options) -> WallRobot:
    """A plant, nominal unless `random`."""
    return make_plant(
        config or RobotConfig(), rng=np.random.default_rng(seed), randomise_truth=random, **options
    )


def rebuilt(plant, *, joints=None, contact=None, **options) -> WallRobot:
    """A plant with the same truth but for some joint or contact parameters."""
    p = plant.parameters
    p = replace(p, joints=replace(p.joints, **(joints or {})), contact=replace(p.contact, **(contact or {})))
    return WallRobot(p, tilt_rad=plant.tilt_rad, **options)


def wait(plant, duration_s) -> None:
    plant.advance(plant.t_ns + round(duration_s * NS_PER_S))


def drive(plant, rates=0.0, angles=0.0) -> None:
    """Wheel rates (rad/s) and steering angles (rad) to the joints, as the robot's software sets them."""
    pairs = zip(np.broadcast_to(rates, 4), np.broadcast_to(angles, 4), strict=True)
    for i, (rate, angle) in enumerate(pairs):
        plant.command(i, JointCommand("velocity", float(rate)))
        plant.command(i + 4, JointCommand("position", float(angle)))


def release(plant) -> None:
    """Torque off, all joints."""
    for joint in range(8):
        plant.command(joint, JointCommand("off"))


def settle(plant, angles=0.0, duration_s=1.0) -> None:
    """Hold still with the steering turned, until transients are over."""
    drive(plant, 0.0, angles)
    wait(plant, duration_s)


def odometry_step(pose, geometry, before, after):
    """Pose after a displacement of joints (8,) to (8,), slip-free."""
    turned = (after[:4] - before[:4]) * geometry.radius_m
    return compose(pose, se2_exp(forward(geometry, turned, 0.5 * (after[4:] + before[4:]))))


def play_back(plant, trajectory, geometry: WheelGeometry):
    """Send a trajectory's wheel motion, listening to nothing; returns end errors of truth and odometry
    and the largest difference between the two, (3,) each."""
    angles = inverse(geometry, trajectory.sample(0.5 * trajectory.duration_s).twist_body)[1]
    settle(plant, angles)
    start_ns, start = plant.t_ns, plant.truth().pose_body_in_wall
    pose, before, apart = start, plant.joints()[0].copy(), np.zeros(3)
    for k in range(round(trajectory.duration_s * NS_PER_S / PERIOD_NS) + 50):
        twist = trajectory.sample((k + 0.5) * PERIOD_NS / NS_PER_S).twist_body
        drive(plant, inverse(geometry, twist)[0] / geometry.radius_m, angles)
        plant.advance(start_ns + (k + 1) * PERIOD_NS)
        after = plant.joints()[0].copy()
        pose, before = odometry_step(pose, geometry, before, after), after
        apart = np.maximum(apart, np.abs(plant.truth().pose_body_in_wall - pose))
    goal = trajectory.sample(trajectory.duration_s).pose_in_wall + start
    return plant.truth().pose_body_in_wall - goal, pose - goal, apart


def track(plant, trajectory, *, hold_s=2.0):
    """Follow a trajectory on odometry alone; returns (truth, odometry, reference), (n, 3) each.

    The software knows the true geometry, as after a perfect calibration; slip it cannot know.
    """
    true = plant.parameters.geometry()
    zero, aligned = true.steering_zero_rad, WheelGeometry(true.x_m, true.y_m, true.radius_m)
    first = inverse(aligned, trajectory.sample(0.01).twist_body)[1]
    settle(plant, first + zero)
    controller = make_controller(ControlConfig(), aligned, trajectory)
    start_ns, offset = plant.t_ns, plant.truth().pose_body_in_wall - trajectory.sample(0.0).pose_in_wall
    pose, before = np.array(trajectory.sample(0.0).pose_in_wall), plant.joints()[0].copy()
    rows = []
    for k in range(round((trajectory.duration_s + hold_s) * NS_PER_S / PERIOD_NS)):
        t_ns = start_ns + k * PERIOD_NS
        plant.advance(t_ns)
        position, rate = plant.joints()[0].copy(), plant.joints()[1].copy()
        pose, before = odometry_step(pose, true, before, position), position
        wheels = WheelMeasurement(
            Stamp(t_ns, t_ns, k), position[:4], rate[:4], position[4:] - zero, (True,) * 4
        )
        reference = trajectory.sample((t_ns - start_ns) / NS_PER_S)
        setpoint = controller.update(RobotState(t_ns, pose, np.zeros(3), np.eye(6)), reference, wheels)
        drive(plant, setpoint.wheel_rate_rad_s, setpoint.steering_rad + zero)
        rows.append((plant.truth().pose_body_in_wall - offset, pose, reference.pose_in_wall))
    truth, odometry, wanted = (np.array(column) for column in zip(*rows, strict=True))
    return truth, odometry, wanted


def assert_falls_freely(make, *, gone_after_s):
    """Without its fan a robot falls with g, and its joints live on.

    Args:
        make: a plant on a wall, of `faults`.
        gone_after_s: how long after the fan it has left the wall.
    """
    faults = FaultPlan([make_fault("plant", "adhesion_loss", at=1.0)])
    plant = make(faults=faults)
    faults.check()
    settle(plant, 0.0, 1.0)
    assert not plant.truth().fallen
    wait(plant, gone_after_s)
    begin = plant.truth()
    drive(plant, 2.0)
    wait(plant, 0.5)
    end = plant.truth()
    assert begin.fallen
    assert end.fallen
    assert end.twist_body[0] - begin.twist_body[0] == pytest.approx(-0.5 * GRAVITY_M_S2, rel=0.02)
    assert end.acceleration_body[0] == pytest.approx(-GRAVITY_M_S2, rel=0.02)
    assert np.all(end.normal_load_n == 0.0)
    np.testing.assert_allclose(end.joint_velocity_rad_s[:4], 2.0, rtol=1e-3)
