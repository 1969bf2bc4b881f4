"""What statics, kinematics and friction say without any model of ours, held against every world."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from two_worlds.bodies import FLOOR, PERIOD_NS, WORLDS, robot, stand, turn, wait
from two_worlds.results import Row

from hil.config.robot import RobotConfig
from hil.core.clock import NS_PER_S
from hil.core.geometry import Array, compose, se2_exp
from hil.fakes.plant import SteppedBody, WallRobot
from hil.fakes.plant.mujoco import MujocoRobot
from hil.fakes.plant.mujoco.model import build_model
from hil.robot.kinematics import forward, inverse
from hil.robot.trajectories import circle

WEIGHT_N = 3.25 * 9.81


def keys() -> Iterator[Row]:
    """Every world once."""
    for world in WORLDS:
        yield {"world": world}


def measure(world: str) -> Row:
    """All figures of a world, nominal robot."""
    return {
        "loads": _loads(world),
        "threshold": [
            round(_threshold(world, s, mu), 2) for s, mu in (("melamine", 0.45), ("concrete", 0.8))
        ],
        "heading_deg": round(_hold_limit_deg(world), 1),
        "drift_um_s": round(_drift_um_s(world), 3),
        "steering_mm": round(_steering_mm(world), 4),
        "circle": _circle(world),
        "stop_ms": round(_stop_ms(world), 1),
        "up": [round(_slip(world, v, 0.0)[0], 2) for v in (0.02, 0.05, 0.1)],
        "across": [round(v, 2) for v in _slip(world, 0.05, math.pi / 2)],
    }


def _loads(world: str) -> list[float]:
    """Sum, moment about the axles and diagonal share of the wheel loads: % off statics."""
    plant = robot(world, config=RobotConfig(thrust_compensation=0.5, propeller_height_m=0.03))
    stand(plant, 0.0, 2.0)
    load, p = plant.truth().normal_load_n, RobotConfig()
    about_y = -0.079 * WEIGHT_N + 0.03 * 0.5 * WEIGHT_N
    sums = (
        load.sum() / 45.0 - 1.0,
        load @ np.array(p.wheel_x_m) / about_y - 1.0,
        load @ [1, -1, 1, -1] / 45.0,
    )
    return [round(100.0 * float(v), 2) for v in sums]


def _between(holds: Callable[[float], bool], falls_at: float, holds_at: float, width: float) -> float:
    """Where `holds` changes."""
    while abs(holds_at - falls_at) > width:
        middle = 0.5 * (falls_at + holds_at)
        falls_at, holds_at = (falls_at, middle) if holds(middle) else (middle, holds_at)
    return 0.5 * (falls_at + holds_at)


def _threshold(world: str, surface: str, friction: float) -> float:
    """Adhesion at which the robot slides, as a share of the closed form."""
    needed_n = 0.3 * WEIGHT_N / friction

    def holds(force_n: float) -> bool:
        plant = robot(world, surface=surface, config=RobotConfig(edf_force_n=force_n))
        stand(plant, 0.0, 3.0)
        return not plant.truth().fallen

    return _between(holds, 0.8 * needed_n, 1.2 * needed_n, 0.01 * needed_n) / needed_n


def _hold_limit_deg(world: str) -> float:
    def holds(degrees: float) -> bool:
        plant = robot(world, start_pose=(0.0, 0.0, math.radians(degrees)))
        stand(plant, 0.0, 3.0)
        return not plant.truth().fallen

    return _between(holds, 60.0, 20.0, 0.5)


def _drift_um_s(world: str) -> float:
    plant = robot(world)
    stand(plant, 0.0, 2.0)
    before = plant.truth().pose_body_in_wall
    wait(plant, 10.0)
    return 1e5 * float(np.abs(plant.truth().pose_body_in_wall - before)[:2].max())


def _steering_mm(world: str) -> float:
    plant = robot(world, **FLOOR)
    stand(plant)
    before = plant.truth().pose_body_in_wall
    for degrees in (90.0, 0.0, 90.0, 0.0):
        stand(plant, math.radians(degrees))
    return 1e3 * float(np.abs(plant.truth().pose_body_in_wall - before)[:2].max())


def _agreeing(world: str) -> SteppedBody:
    """On the floor, with steering that reaches its goal: wheels that agree with each other."""
    p = robot(world, **FLOOR).parameters
    coulomb = np.array([0.04] * 4 + [0.0] * 4)
    radius = RobotConfig().wheel_radius_m
    joints = replace(p.joints, play_rad=np.zeros(4), coulomb_n_m=coulomb)
    p = replace(p, joints=joints, wheel_radius_m=np.array(radius))
    if world == "own":
        return WallRobot(p, tilt_rad=0.0)
    from hil.fakes.plant.mujoco import CONTACTS

    return MujocoRobot(build_model(p, CONTACTS[world]), p, tilt_rad=0.0)


def _circle(world: str) -> list[float]:
    """Largest distance (mm) and angle (deg) between robot and its wheels' odometry on a circle of 3 m."""
    plant = _agreeing(world)
    geometry = plant.parameters.geometry()
    path = circle((0, 0, 0), 3.0 / (2.0 * math.pi), speed_m_s=0.118)
    angles = inverse(geometry, path.sample(0.5 * path.duration_s).twist_body)[1]
    stand(plant, angles)
    start_ns, pose, before = plant.t_ns, plant.truth().pose_body_in_wall, plant.joints()[0].copy()
    apart = np.zeros(3)
    for k in range(round(path.duration_s * NS_PER_S / PERIOD_NS) + 50):
        twist = path.sample((k + 0.5) * PERIOD_NS / NS_PER_S).twist_body
        turn(plant, inverse(geometry, twist)[0] / geometry.radius_m, angles)
        plant.advance(start_ns + (k + 1) * PERIOD_NS)
        after = plant.joints()[0].copy()
        turned = (after[:4] - before[:4]) * geometry.radius_m
        pose = compose(pose, se2_exp(forward(geometry, turned, 0.5 * (after[4:] + before[4:]))))
        apart, before = np.maximum(apart, np.abs(plant.truth().pose_body_in_wall - pose)), after
    return [round(1e3 * float(np.hypot(*apart[:2])), 3), round(math.degrees(apart[2]), 4)]


def _stop_ms(world: str) -> float:
    """Time from 90 to 10 % of 2 rad/s after a step to zero, floor, mean of the wheels."""
    plant = robot(world, **FLOOR)
    stand(plant)
    turn(plant, 1.966, 0.0)
    wait(plant, 1.0)
    turn(plant, 0.0, 0.0)
    rates = []
    for _ in range(400):
        wait(plant, 0.001)
        rates.append(float(np.mean(plant.joints()[1][:4])))
    falling: Array = np.array(rates)
    return float(np.argmax(falling < 0.1966) - np.argmax(falling < 1.7694))


def _slip(world: str, speed_m_s: float, angle_rad: float) -> tuple[float, float]:
    """% of the way that is lost, and mm of sag per metre (across), melamine, half a metre."""
    plant = robot(world)
    stand(plant, angle_rad)
    turn(plant, speed_m_s / 0.0254, angle_rad)
    wait(plant, 0.5)
    start, before = plant.truth().pose_body_in_wall, plant.joints()[0][:4].copy()
    wait(plant, 0.3 / speed_m_s)
    moved = plant.truth().pose_body_in_wall - start
    way_m = float(np.mean((plant.joints()[0][:4] - before) * plant.parameters.wheel_radius_m))
    if angle_rad == 0.0:
        return 100.0 * (1.0 - float(moved[0]) / way_m), 0.0
    return 100.0 * (1.0 - float(moved[1]) / way_m), -1e3 * float(moved[0]) / way_m
