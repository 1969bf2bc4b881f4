"""Sensors by which a robot on its wheels leaves the plane that it rolls on: their axes are turned.

A turn about the direction of gravity does not show at rest. Of a sensor that is turned by 90 degrees about it
the steps along the surface, or the turns, point out of the surface: they are missing where the wheels push.
"""

import numpy as np

from hil.config.bench import BenchConfig
from hil.config.device import ImuConfig, TrackerConfig
from hil.core.geometry import Array, conjugated, rotated
from hil.core.signals import Status
from hil.loop.driven_motion import Motion
from hil.procedure.sample_arrays import camera, inertial

_LEAVES_M, _TURNS_RAD_S = 0.001, 0.004
"""Ways and rates that count: a camera has 0.3 mm of noise, a gyro 2 mrad/s."""
_MEANS_S = 0.05
"""Time over which samples are averaged."""
LOOK_AT = {
    "mocap": "mocap.up_axis, at the plane, and at the axes of mocap.body",
    "tracker": "tracker.mount_rotation_wxyz",
    "imu": "imu.mount_rotation_wxyz",
}
"""What to look at, by sensor."""


def off_plane(source: str, motion: Motion, config: BenchConfig) -> tuple[str, ...]:
    """Return the sensors whose axes are turned: the source, and then a gyro that turns about another axis.

    Args:
        source: device whose poses show the motion, `mocap` or `tracker`.
        motion: pushes of single wheels, which move and turn the body.
        config: configuration of the bench.
    """
    ways = _by_capture(motion) if source == "mocap" else _by_camera(motion, config)
    if not _leaves(ways, _LEAVES_M):
        return ()
    return (source, *(["imu"] if _leaves(_rates(motion, config), _TURNS_RAD_S, turns=True) else []))


def _leaves(rows: Array, least: float, *, turns: bool = False) -> bool:
    """Whether rows (n, 3) in body axes lie out of the plane: along its normal, or for turns across it."""
    if not len(rows):
        return False
    x, y, z = np.ptp(rows, axis=0)
    out, within = (np.hypot(x, y), z) if turns else (z, np.hypot(x, y))
    return bool(out > max(least, within))


def _by_capture(motion: Motion) -> Array:
    """Places (n, 3) in the plane of motion capture and out of it."""
    return np.array(
        [s.position_m for r in motion.records for s in r.inputs.mocap if s.status is Status.OK]
    ).reshape(-1, 3)


def _by_camera(motion: Motion, config: BenchConfig) -> Array:
    """Places (n, 3) of the camera in the axes that the body has at first, by the mount of the bench file."""
    mount, seen = config.of(TrackerConfig), camera(motion)
    if mount is None or not len(seen):
        return np.zeros((0, 3))
    back = conjugated(seen.values[0, 3:7].tolist())
    ways = _averaged(seen.t_s, seen.values[:, :3] - seen.values[0, :3])
    return np.array([rotated(mount.mount_rotation_wxyz, rotated(back, way)) for way in ways.tolist()])


def _rates(motion: Motion, config: BenchConfig) -> Array:
    """Turn rates (n, 3) by the gyro in body axes, by the mount of the bench file."""
    mount, seen = config.of(ImuConfig), inertial(motion)
    if mount is None or not len(seen):
        return np.zeros((0, 3))
    rates = _averaged(seen.t_s, seen.values[:, 2:5])
    return np.array([rotated(mount.mount_rotation_wxyz, rate) for rate in rates.tolist()])


def _averaged(t_s: Array, rows: Array) -> Array:
    """Means (m, k) of rows (n, k) over stretches of time."""
    _, stretch, counts = np.unique(np.floor(t_s / _MEANS_S), return_inverse=True, return_counts=True)
    sums = np.zeros((len(counts), rows.shape[1]))
    np.add.at(sums, stretch, rows)
    return sums / counts[:, None]
