"""What one turn of the body shows of a mount: the axis by IMU and camera, and the place of the camera.

A robot on its wheels turns about the normal of its surface. Gravity shows two axes of a mount, and nothing of
a turn about the vertical. On a wall the axis of a turn shows that one: together they show the whole mount.
"""

import math
from collections.abc import Iterator

import numpy as np

from hil.bench.cross_checks.gravity import MOST_RAD
from hil.config.bench import BenchConfig
from hil.config.device import MountedConfig, TrackerConfig
from hil.core.cross_check import CrossCheck
from hil.core.geometry import Array, conjugated, multiplied, rotated
from hil.loop.checks.wrong_parameter import explained_by_lever
from hil.loop.driven_motion import Motion
from hil.procedure.sample_arrays import camera, inertial, integrated

_LEAST_RAD = 0.04
"""Turn from which its axis counts: the noise of a camera is then a twentieth."""
_REST_S = 0.3
_PLACE_M, _FAR_M = 0.03, 0.05
"""Differences of a place: up to the first a turn confirms it, beyond the other it contradicts it. A camera's
noise is a third of the first."""
_CALLED = {"imu": "the IMU", "tracker": "the camera"}


def turn_checks(config: BenchConfig, motion: Motion, turned_rad: float) -> Iterator[CrossCheck]:
    """Compare the mounts of IMU and camera with the axis of one turn of the body.

    Args:
        config: configuration of the bench.
        motion: a turn on the spot, at rest before and after it.
        turned_rad: turn of the body.

    Yields:
        Confirmations leave beside what gravity shows.
    """
    for name, seen in (("imu", _by_gyro(motion)), ("tracker", _by_camera(motion))):
        mount = config.devices().get(name)
        size_rad = float(np.linalg.norm(seen))
        if not isinstance(mount, MountedConfig) or not size_rad > _LEAST_RAD:
            continue
        axis = (np.sign(turned_rad) / size_rad * seen).tolist()
        x, y, z = rotated(mount.mount_rotation_wxyz, axis)
        off_rad = float(np.arctan2(np.hypot(x, y), z))
        key, value = f"{name}.mount_rotation_wxyz", mount.mount_rotation_wxyz
        if off_rad <= MOST_RAD:
            by = "gravity and small motions"
            yield CrossCheck(
                key,
                value,
                "confirmed",
                by,
                value,
                off_rad,
                beside="what gravity shows",
                within=MOST_RAD,
                unit="rad",
            )
        elif z > -0.9:  # a turn the other way round is told by its sign
            about = np.array([1.0 + z, y, -x, 0.0])
            says = multiplied((about / np.linalg.norm(about)).tolist(), value)
            text = (
                f"{_CALLED[name]} sees the body turn about an axis {np.degrees(off_rad):.0f} deg off the "
                f"normal of the surface: look at {key}"
            )
            yield CrossCheck(
                key, value, "contradicted", "the axis of a turn", says, off_rad, text, unit="rad"
            )


def place_checks(config: BenchConfig, lever_m: float) -> Iterator[CrossCheck]:
    """Compare the place of the camera on the body with how a turn moves it.

    Args:
        config: configuration of the bench.
        lever_m: distance between the body's steps by camera and motion capture, over the turn, m per rad.
    """
    mount = config.of(TrackerConfig)
    if mount is None:
        return
    key, value = "tracker.mount_position_m", mount.mount_position_m
    if lever_m <= _PLACE_M:
        yield CrossCheck(key, value, "confirmed", "small motions", value, lever_m, within=_PLACE_M, unit="m")
    elif found := explained_by_lever("tracker", lever_m) if lever_m > _FAR_M else None:
        text = f"a turn moves the body by the camera: look at {key}, {found.text}"
        yield CrossCheck(key, value, "contradicted", "motion capture", math.nan, lever_m, text, unit="m")


def _by_gyro(motion: Motion) -> Array:
    """Turn by the gyro, (3,) in sensor axes, rad; its bias is that of the rest at the end."""
    data = inertial(motion)
    if len(data) < 2:
        return np.zeros(3)
    end_s = float(data.t_s[-1])
    bias = data.between(end_s - _REST_S, end_s)[2:5]
    return np.array([integrated(data.t_s, data[k] - bias[k - 2])[-1] for k in (2, 3, 4)])


def _by_camera(motion: Motion) -> Array:
    """Turn by the camera, (3,) in its axes, rad."""
    data = camera(motion)
    if len(data) < 2:
        return np.zeros(3)
    end_s = float(data.t_s[-1])
    first, last = data.between(-1.0, 0.1)[3:7], data.between(end_s - _REST_S, end_s)[3:7]
    w, *v = multiplied(conjugated(first.tolist()), last.tolist())
    size = float(np.linalg.norm(v))
    return np.array(v, dtype=np.float64) * float(2.0 * np.arctan2(size, w) / max(size, 1e-12))
