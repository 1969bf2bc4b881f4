"""Moves of a robot over strides of one second: by its wheels, ground truth, gyro and camera.

Each is in the robot's own frame at the begin of the stride, where neither drift nor a start heading counts.
"""

from dataclasses import replace

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.geometry import Array, quat_rotate
from hil.core.signals import Inputs, Status
from hil.datasets.sampling import interpolate, wheel_steps
from hil.datasets.wheel_log import Recording
from hil.loop.alignment import Alignment
from hil.robot.kinematics import WheelGeometry, forward
from hil.robot.odometry import integrate

_STRIDE_S, _FINE = 1.0, 50


def moves_by_wheels(recording: Recording, edges_s: Array, geometry: WheelGeometry) -> Array:
    """Moves (S, 3) between edges (S + 1,), each in the frame of its begin."""
    fine_s = np.linspace(edges_s[0], edges_s[-1], (len(edges_s) - 1) * _FINE + 1)
    rotation, steering = wheel_steps(recording, fine_s, "position")
    return moves(integrate(np.zeros(3), forward(geometry, rotation * geometry.radius_m, steering))[::_FINE])


def moves(poses: Array) -> Array:
    """Moves (S, 3) between poses (S + 1, 3), each in the frame of its begin."""
    x, y, turn = np.diff(poses, axis=0).T
    way = (x + 1j * y) * np.exp(-1j * poses[:-1, 2])
    return np.column_stack([way.real, way.imag, turn])


def stride_edges(recording: Recording, t_s: Array) -> Array:
    """Edges (S + 1,) of the strides that wheels and a sensor share, s."""
    begin_s, end_s = max(recording.t_s[0], t_s[0]), min(recording.t_s[-1], t_s[-1])
    return np.asarray(np.arange(begin_s, end_s, _STRIDE_S), dtype=np.float64)


def gyro_turns(recording: Recording) -> tuple[Array, Array]:
    """Times (n,) of the gyro's samples, s, and turns (n, 3) since the first about the robot's axes, rad."""
    samples = [one for one in recording.sensors.imu if one.status is Status.OK]
    t_s = np.array([one.stamp.t_ns for one in samples]) / NS_PER_S
    if not len(t_s):
        return t_s, np.zeros((0, 3))
    mount = recording.sensors.parameters.imu.rotation_wxyz
    rates = np.array([quat_rotate(mount, one.gyro_rad_s) for one in samples])
    middle = 0.5 * (rates[1:] + rates[:-1]) * np.diff(t_s)[:, None]
    return t_s, np.vstack([np.zeros(3), np.cumsum(middle, axis=0)])


def turns_by_gyro(recording: Recording) -> tuple[Array, Array]:
    """Edges (S + 1,), s, and turns (S, 3) between them about the robot's axes, rad; empty without a gyro."""
    t_s, turned = gyro_turns(recording)
    if len(t_s) < 2 or len(edges_s := stride_edges(recording, t_s)) < 2:
        return np.zeros(0), np.zeros((0, 3))
    return edges_s, np.diff(interpolate(edges_s, t_s, turned), axis=0)


def camera_path(recording: Recording) -> tuple[Array, Array]:
    """Times (n,) of the camera's poses, s, and the poses (n, 3) of the robot since the first."""
    log = recording.sensors
    alignment = Alignment(replace(log.parameters, on_wall=False))
    poses = [p for p in alignment.measure(Inputs(0, 0, tracker=log.tracker)).tracker if p.valid]
    t_s = np.array([one.stamp.t_ns for one in poses]) / NS_PER_S
    return t_s, np.array([one.pose for one in poses], dtype=np.float64).reshape(-1, 3)


def moves_by_camera(recording: Recording) -> tuple[Array, Array]:
    """Edges (S + 1,), s, and moves (S, 3) between them by the camera; empty without one."""
    t_s, poses = camera_path(recording)
    if len(t_s) < 2 or len(edges_s := stride_edges(recording, t_s)) < 2:
        return np.zeros(0), np.zeros((0, 3))
    return edges_s, moves(interpolate(edges_s, t_s, poses))


def moves_by_truth(recording: Recording) -> tuple[Array, Array]:
    """Edges (S + 1,), s, and moves (S, 3) between them by the ground truth; empty without it."""
    t_s = recording.truth_t_s
    if not recording.has_truth or len(edges_s := stride_edges(recording, t_s)) < 2:
        return np.zeros(0), np.zeros((0, 3))
    return edges_s, moves(interpolate(edges_s, t_s, recording.truth_pose))
