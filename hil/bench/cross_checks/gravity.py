"""Gravity in the body, by IMU, camera and motion capture: it shows the mounts, the tilt, and the frame.

At rest an IMU and a tracking camera each measure the direction of gravity. With its mount each gives the up
axis in the body: a tilt against the surface, and on a wall a heading. Motion capture gives a heading in a
frame whose x axis points up the wall, and the bench file gives the tilt. Of these the one that two others
contradict is wrong; of two that differ either may be. A rotation about the vertical shows in none of them.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.bench.hold.tilt_check import APART_RAD, up_by_imu
from hil.config.bench import BenchConfig
from hil.config.device import MountedConfig, TrackerConfig
from hil.config.environment import FLOOR_TILT_RAD
from hil.config.mocap import MocapConfig
from hil.config.servos import ServosConfig
from hil.core.cross_check import CrossCheck
from hil.core.geometry import Three, conjugated, mean_angle, multiplied, rotated, wrap, yaw_of_quat
from hil.core.signals import Status
from hil.loop.checks.out_of_plane import tipped_rad

MOST_RAD = 0.07
"""Difference that good mounts may have, 4 deg: fused gravity is good to 1 deg, a rigid body's axes to 2."""
_TWO_RAD = 0.14
"""Largest difference of the bench file's tilt from that which IMU and camera both show, rad."""
FEWEST = 10
"""Number of samples of a sensor from which it counts."""
_STEEP = 0.3
"""Share of gravity in the plane from which it gives a heading."""
_Q = "mount_rotation_wxyz"
_ABOUT_VERTICAL = "a turn about the vertical"


class Witness(NamedTuple):
    """What one source says of an angle.

    Attributes:
        key: key of the bench file that would be wrong.
        value: its value.
        called: the source in words.
        angle_rad: angle by this source.
        says: value of the key that another angle would mean, as a function of that angle.
    """

    key: str
    value: Any
    called: str
    angle_rad: float
    says: Any


def gravity_checks(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Iterator[CrossCheck]:
    """Compare tilt and heading by all that measure them.

    Args:
        config: configuration of the bench.
        seen: samples of the resting robot, by kind.
    """
    if config.of(ServosConfig) is None:
        return
    here = {name: () if name in config.elsewhere() else samples for name, samples in seen.items()}
    ups = {
        name: up for name, up in (("imu", _by_imu(config, here)), ("tracker", _by_camera(config, here))) if up
    }
    yield from _tilts(config, ups)
    yield from _tipped(config, here)
    headings = [_heading(config, name, up) for name, up in ups.items() if math.hypot(*up[:2]) > _STEEP]
    if config.environment.on_wall and config.environment.tilt_rad < math.pi - _STEEP:
        mounts = " and ".join(w.key for w in headings)
        both = f", or both {mounts}: a plate that bears both" if len(headings) > 1 else ""
        yield from judged(headings + list(_by_capture(config, here)), f"or the axes of its plane{both}")


def _by_imu(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Three | None:
    """Up axis in the body by the IMU; None without enough samples, or if they are no gravity."""
    good = [s for s in seen.get("imu", ()) if s.status is Status.OK]
    return up_by_imu(config, good) if len(good) >= FEWEST else None


def _by_camera(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Three | None:
    """Up axis in the body by the camera, whose own frame has gravity along -z."""
    mount = config.of(TrackerConfig)
    good = [s.quaternion_wxyz.tolist() for s in seen.get("tracker", ()) if s.status is Status.OK]
    if mount is None or len(good) < FEWEST:
        return None
    up = np.mean([rotated(conjugated(q), (0.0, 0.0, 1.0)) for q in good], axis=0)
    size = float(np.linalg.norm(up))
    return rotated(mount.mount_rotation_wxyz, (up / size).tolist()) if 0.9 < size < 1.1 else None


def _by_capture(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Iterator[Witness]:
    table = config.of(MocapConfig)
    good = [
        float(yaw_of_quat(s.quaternion_wxyz))
        for s in seen.get("mocap", ())
        if s.status is Status.OK and s.tracking_valid
    ]
    if table is not None and len(good) >= FEWEST:
        yield Witness("mocap.body", table.body, "motion capture", mean_angle(good), lambda _: math.nan)


def _tipped(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Iterator[CrossCheck]:
    """A rigid body that stands in the plane of motion, as a robot on its wheels does."""
    table = config.of(MocapConfig)
    good = [tipped_rad(s) for s in seen.get("mocap", ()) if s.status is Status.OK and s.tracking_valid]
    if table is None or len(good) < FEWEST or (off_rad := float(np.median(good))) <= MOST_RAD:
        return
    text = (
        f"motion capture sees the resting robot tipped by {math.degrees(off_rad):.1f} deg out of its plane: "
        "look at mocap.up_axis, at the plane, and at the axes of mocap.body"
    )
    for key, value in (("mocap.up_axis", table.up_axis), ("mocap.body", table.body)):
        by = "the plane of motion"
        yield CrossCheck(key, value, "contradicted", by, math.nan, off_rad, text, unit="rad")


def _heading(config: BenchConfig, name: str, up: Three) -> Witness:
    """Heading by the up axis of a device."""
    key, value = _mount(config, name)
    heading_rad = math.atan2(-up[1], up[0])
    half = 0.5
    # turned about the body's z by the difference, the device would show the other heading
    return Witness(
        key,
        value,
        _CALLED[name],
        heading_rad,
        lambda other: multiplied(_about_z(half * wrap(heading_rad - other)), value),
    )


_CALLED = {"imu": "the IMU's gravity", "tracker": "the camera's gravity"}


def _about_z(half_rad: float) -> tuple[float, float, float, float]:
    return math.cos(half_rad), 0.0, 0.0, math.sin(half_rad)


def _mount(config: BenchConfig, name: str) -> tuple[str, Any]:
    table = config.devices()[name]
    assert isinstance(table, MountedConfig)
    return f"{name}.{_Q}", table.mount_rotation_wxyz


def _tilts(config: BenchConfig, ups: Mapping[str, Three]) -> Iterator[CrossCheck]:
    """Compare the tilt of the bench file with that by IMU and camera."""
    file_rad = config.environment.tilt_rad
    tilts = {name: math.acos(max(-1.0, min(1.0, up[2]))) for name, up in ups.items()}
    key = "environment.tilt_rad"
    if not tilts:
        return
    first = next(iter(tilts))
    alike = max(tilts.values()) - min(tilts.values()) <= MOST_RAD
    off_rad = tilts[first] - file_rad
    if alike or len(tilts) == 1:
        by = " and ".join(_CALLED[name] for name in tilts)
        ramp = not config.environment.on_wall and tilts[first] > FLOOR_TILT_RAD + MOST_RAD
        most_rad = APART_RAD if len(tilts) == 1 else _TWO_RAD
        if ramp or abs(off_rad) > most_rad:  # a ramp asks for the guards of a wall, which are off
            text = (
                f"{key}: by {by} the robot is tilted by {math.degrees(tilts[first]):.0f} deg, "
                f"bench file says {math.degrees(file_rad):.0f}; "
                "set environment.tilt_rad and surface to what the robot stands on"
            )
            if len(tilts) == 1:
                text += f"; if they are right, {first}.{_Q} is not"
            yield CrossCheck(key, file_rad, "contradicted", by, tilts[first], off_rad, text, unit="rad")
        elif abs(off_rad) > MOST_RAD:  # wheels hold as the file says, and yet it is another slope
            by += f", which show {math.degrees(tilts[first]):.0f} deg"
            yield CrossCheck(key, file_rad, "unconfirmed", by, tilts[first], off_rad, unit="rad")
        else:
            yield CrossCheck(
                key, file_rad, "confirmed", by, tilts[first], off_rad, within=MOST_RAD, unit="rad"
            )
        return
    witnesses = [
        Witness(*_mount(config, name), _CALLED[name], tilt_rad, lambda _: math.nan)
        for name, tilt_rad in tilts.items()
    ]
    yield from judged(
        [*witnesses, Witness(key, file_rad, "the bench file", file_rad, lambda other: other)], ""
    )


def judged(witnesses: Sequence[Witness], beside: str) -> Iterator[CrossCheck]:
    """Results for the keys of sources that measure one angle: the one that all others contradict is wrong.

    Args:
        witnesses: statement of each source.
        beside: another possible error of the last source, in words.
    """
    if len(witnesses) < 2:
        return
    for one in witnesses:
        others = [w for w in witnesses if w is not one]
        near = [w for w in others if abs(wrap(w.angle_rad - one.angle_rad)) <= MOST_RAD]
        if near:
            off_rad = wrap(one.angle_rad - near[0].angle_rad)
            turn = _ABOUT_VERTICAL if one.key.endswith(_Q) else ""
            yield CrossCheck(
                one.key,
                one.value,
                "confirmed",
                near[0].called,
                one.value,
                off_rad,
                beside=turn,
                within=MOST_RAD,
                unit="rad",
            )
            continue
        agree = len(others) > 1 and all(
            abs(wrap(a.angle_rad - b.angle_rad)) <= MOST_RAD for a in others for b in others
        )
        off_rad = wrap(one.angle_rad - others[0].angle_rad)
        by = " and ".join(w.called for w in others)
        said = "; ".join(f"{w.called} {math.degrees(w.angle_rad):+.1f} deg" for w in witnesses)
        if agree or len(others) == 1 or not any(_pair(others)):
            either = "" if agree else f"; either {' or '.join(w.key for w in witnesses)} is wrong"
            also = f" ({beside})" if beside and one is witnesses[-1] else ""
            text = f"{one.key}{also}: {said}{either}"
            says = one.says(others[0].angle_rad)
            yield CrossCheck(one.key, one.value, "contradicted", by, says, off_rad, text, unit="rad")


def _pair(witnesses: Sequence[Witness]) -> Iterator[bool]:
    """Whether two sources agree, for each pair."""
    for k, one in enumerate(witnesses):
        for other in witnesses[k + 1 :]:
            yield abs(wrap(one.angle_rad - other.angle_rad)) <= MOST_RAD
