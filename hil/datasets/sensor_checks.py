"""Compares IMU and camera of another robot's bag with its wheels: axes, signs, factors, gravity, time.

A recorded twist is compared with the ground truth in the same way.
A wrong mount would not show in the filters: they average it away or reject the sensor. Moves of one second
are compared, each in the robot's own frame, where neither drift nor a start heading counts. A sensor is
judged by a motion only where there is enough of it.
"""

import math
from collections.abc import Iterator

import numpy as np

from hil.core.geometry import Array, quat_rotate
from hil.datasets.sampling import interpolate
from hil.datasets.sensor_moves import moves, moves_by_camera, moves_by_truth, moves_by_wheels, turns_by_gyro
from hil.datasets.sensor_times import late_sensors
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import WheelGeometry
from hil.robot.statics import GRAVITY_M_S2

_LEAST_RAD, _LEAST_M = 0.3, 0.1
"""Root of the summed squares of the moves from which turning and way are compared."""
_NEAR, _SAME, _FACTOR, _ANGLE_RAD = 0.3, 0.15, 1.25, 0.35
_TURNED = 2.0
"""Factor of turning that no slip explains: skid steering turns by half as much again."""
_FEWEST, _LEVER_M, _SCALED, _ERRORS = 5, 0.03, 0.05, 5.0
"""Fewest moves, lever and scale of a camera that are named, and by how many standard errors."""
_LEANS = math.cos(_ANGLE_RAD)
_MOUNT = "correct its mount_rotation_wxyz, or its frame"
_IN_IT = 'gravity is in it: set gravity = "in_force"'
_NORMS = (
    (GRAVITY_M_S2, ""),
    (0.0, 'gravity is not in it: set gravity = "removed"'),
    (2.0 * GRAVITY_M_S2, _IN_IT),
    (1.0, "it is in g: let the driver send m/s^2"),
)
"""Lengths of the specific force, m/s^2, that mean something; the first is right."""


def sensor_contradictions(recording: Recording, geometry: WheelGeometry, *, on_wall: bool) -> list[str]:
    """One line for each sensor that contradicts the wheels or gravity, with what would agree.

    Args:
        recording: recording with its sensors.
        geometry: geometry of the wheels.
        on_wall: True where gravity lies in the motion plane.
    """
    found = (
        *late_sensors(recording, geometry),
        *_of_twist(recording, geometry),
        *_of_rates(recording, geometry),
        *_of_gravity(recording, on_wall),
        *_of_camera(recording, geometry),
    )
    return [f"{recording.name}: {line}" for line in found]


def _of_rates(recording: Recording, geometry: WheelGeometry) -> Iterator[str]:
    edges_s, turned = turns_by_gyro(recording)
    if not len(turned):
        return
    true = moves_by_wheels(recording, edges_s, geometry)[:, 2]
    whole = float(np.linalg.norm(true))

    def missed(other: Array) -> float:
        return float(np.linalg.norm(other - true)) / whole

    if whole < _LEAST_RAD or missed(turned[:, 2]) < _NEAR:
        return
    says = "[imu]: its turning about the robot's z axis contradicts the wheels"
    for axis, name in enumerate("xyz"):
        for sign, word in ((1.0, ""), (-1.0, "-")):
            if missed(sign * turned[:, axis]) < _NEAR:
                yield f"{says}, that about {word}{name} agrees: {_MOUNT}"
                return
    factor = float(turned[:, 2] @ true) / whole**2
    yield f"{says}: it is {factor:.3g} times theirs; look at unit (rad/s) and mount"


def _of_gravity(recording: Recording, on_wall: bool) -> Iterator[str]:
    log = recording.sensors
    force = np.array([one.specific_force_m_s2 for one in log.imu]).reshape(-1, 3)
    force = force[np.isfinite(force).all(axis=1)]
    if not len(force):
        linear = np.array([one.linear_acceleration_m_s2 for one in log.imu]).reshape(-1, 3)
        norms = np.linalg.norm(linear[np.isfinite(linear).all(axis=1)], axis=1)
        if len(norms) and abs(float(np.median(norms)) - GRAVITY_M_S2) < 1.0:
            yield f"[imu]: its acceleration is {np.median(norms):.2f} m/s^2 (median): {_IN_IT}"
        return
    norm = float(np.median(np.linalg.norm(force, axis=1)))
    nearest, remedy = min(_NORMS, key=lambda one: abs(one[0] - norm))
    if remedy or abs(norm - nearest) > 1.0:
        yield f"[imu]: its specific force is {norm:.2f} m/s^2 (median): {remedy or 'look at its unit'}"
        return
    up = quat_rotate(log.parameters.imu.rotation_wxyz, np.median(force, axis=0))
    along = float(up[2]) / float(np.linalg.norm(up))
    if along < _LEANS and not on_wall:
        degrees = math.degrees(math.acos(along))
        yield f"[imu]: upwards is {degrees:.0f} deg from the robot's z axis, on a floor: {_MOUNT}"
    if on_wall and abs(along) > math.sin(_ANGLE_RAD):
        degrees = math.degrees(math.asin(along))
        yield f"[imu]: upwards is {degrees:.0f} deg out of the motion plane, on a wall: {_MOUNT}"


def _of_camera(recording: Recording, geometry: WheelGeometry) -> Iterator[str]:
    edges_s, seen = moves_by_camera(recording)
    if not len(seen):
        return
    true = moves_by_wheels(recording, edges_s, geometry)
    contradicted = list(_of_moves("[tracker]", "the wheels", seen, true, (_MOUNT, "look at scale and unit")))
    yield from contradicted
    if contradicted:
        return
    other = "the wheels"
    if recording.has_truth:
        known = (edges_s >= recording.truth_t_s[0]) & (edges_s <= recording.truth_t_s[-1])
        by_truth = moves(interpolate(edges_s, recording.truth_t_s, recording.truth_pose))
        both = known[1:] & known[:-1]
        if np.linalg.norm((by_truth - true)[both]) < _SAME * np.linalg.norm(true[both]):
            seen, true, other = seen[both], by_truth[both], "the ground truth"
    if other == "the wheels" and recording.of_twist:
        return
    yield from _of_lever(seen, true, other)


def _of_lever(seen: Array, true: Array, other: str) -> Iterator[str]:
    """Lines on moves (S, 3) of a camera that is elsewhere than its mount says, or of another scale.

    A camera that is elsewhere by a lever moves by (exp(i turn) - 1) lever more, in the frame of the begin.
    On a single circle that is a part of the way, and nothing is judged.
    """
    way, turning = true[:, 0] + 1j * true[:, 1], np.exp(1j * seen[:, 2]) - 1.0
    model, moved = np.column_stack([way, turning]), seen[:, 0] + 1j * seen[:, 1]
    if len(seen) < _FEWEST or np.linalg.svd(model, compute_uv=False)[-1] < _LEAST_M:
        return
    (scale, lever_m), *_ = np.linalg.lstsq(model, moved, rcond=None)
    noise = float(np.linalg.norm(moved - model @ [scale, lever_m])) / math.sqrt(len(seen) - 2)
    errors = noise * np.sqrt(np.diag(np.linalg.inv(model.conj().T @ model)).real)
    if abs(lever_m) > max(_LEVER_M, _ERRORS * errors[1]):
        x_mm, y_mm = 1e3 * lever_m.real, 1e3 * lever_m.imag
        yield (
            f"[tracker]: by {other} it is {x_mm:.0f} mm in x and {y_mm:.0f} mm in y from where its mount "
            "says: correct its mount_position_m, or its frame"
        )
    if other != "the wheels" and abs(abs(scale) - 1.0) > max(_SCALED, _ERRORS * errors[0]):
        yield f"[tracker]: its way is {abs(scale):.3g} times that of {other}: look at its scale"


def _of_twist(recording: Recording, geometry: WheelGeometry) -> Iterator[str]:
    edges_s, true = moves_by_truth(recording)
    if not recording.of_twist or not len(true):
        return
    by_twist = moves_by_wheels(recording, edges_s, geometry)
    remedies = ("look at its axes (x forward, y left), or at the mount of [truth]", "look at its unit (m/s)")
    yield from _of_moves("[odometry]", "the ground truth", by_twist, true, remedies)


def _of_moves(table: str, other: str, seen: Array, true: Array, remedies: tuple[str, str]) -> Iterator[str]:
    """Lines on moves (S, 3) of a table's sensor that contradict the `other`'s; remedies: axes, unit."""
    axes, unit = remedies
    whole = float(np.linalg.norm(true[:, 2]))
    turns = float(seen[:, 2] @ true[:, 2]) / max(whole, _LEAST_RAD) ** 2
    if whole > _LEAST_RAD and turns < 0.0:
        yield f"{table}: it turns against {other}: {axes}"
        return
    if table == "[odometry]" and whole > _LEAST_RAD and not 1.0 / _TURNED < turns < _TURNED:
        yield f"{table}: it turns {turns:.3g} times as far as {other}: look at its unit (rad/s)"
    way = true[:, 0] + 1j * true[:, 1]
    size = float(np.linalg.norm(way))
    if size < _LEAST_M:
        return
    ratio = complex(np.vdot(way, seen[:, 0] + 1j * seen[:, 1])) / size**2
    if abs(angle := math.atan2(ratio.imag, ratio.real)) > _ANGLE_RAD and abs(ratio) > _NEAR:
        degrees = math.degrees(angle)
        yield f"{table}: its way is turned by {degrees:.0f} deg about z from that of {other}: {axes}"
    elif not 1.0 / _FACTOR < abs(ratio) < _FACTOR:
        yield f"{table}: its way is {abs(ratio):.3g} times that of {other}: {unit}"
