"""What small steps of the body say of the bench file: wheels and camera against what shows the body.

Each comparison has two bounds. Up to the first it confirms, beyond the second it contradicts; between them is
what slip, horns of a robot as delivered, and the axes of a rigid body may cost.
"""

import cmath
import math
from collections.abc import Iterator, Mapping

import numpy as np

from hil.bench.doctor.steering_offsets import encoder_minus_servo
from hil.config.bench import BenchConfig
from hil.config.encoders import EncodersConfig
from hil.config.mocap import MocapConfig
from hil.core.cross_check import CrossCheck
from hil.core.geometry import Array, wrap
from hil.loop.driven_motion import Motion

SAME, WRONG = 0.06, 0.12
"""Shares: small steps show wheels to 4 %, and a camera with three times its noise to 2 %."""
_CREEP = 0.3
"""Share by which wheels may turn further than a body climbs."""
_SAME_RAD, _WRONG_RAD = 0.04, 0.06
"""Directions of steps: a camera with three times its noise shows them to 0.02 rad, and a rigid body's axes
are good to 2 deg."""
_TURN_RAD, _TURN_RAD_M = 0.0035, 0.0625
"""Turn by the wheels on a straight step that is none: at rest, and by way. A mass beside the centre turns a
robot on a wall by 0.06 rad/m."""
_HORNS_RAD = 0.044
"""Directions of wheels that no encoder shows: 2.5 deg of a horn."""
_BY = "small motions"
_RADIUS, _PLACES = "robot.wheel_radius_m", ("robot.wheel_x_m", "robot.wheel_y_m")
_MOUNT, _BODY, _ZEROS = "tracker.mount_rotation_wxyz", "mocap.body", "alignment.steer_zero_rad"
_IMU_MOUNT = "imu.mount_rotation_wxyz"

Ways = Mapping[str, Array]
"""Steps along x, along y and a turn, by source: (3, 3) rows of x, y (m) and turn (rad), in the body at its
start."""


def step_checks(config: BenchConfig, ways: Ways, steered_off: Array) -> Iterator[CrossCheck]:
    """Compare steps of the body by wheels and camera with those by motion capture.

    Args:
        config: configuration of the bench.
        ways: steps by `odometry`, `mocap` and, where there is one, `tracker`.
        steered_off: (4,) true steering less that of the servos, rad; NaN where no encoder shows it.
    """
    yield from _wheels(config, ways["odometry"], ways["mocap"], steered_off)
    yield from _directions(config, ways)
    if "tracker" in ways:
        tracker = config.devices()["tracker"]
        off = max((_share(ways["tracker"][k, k], ways["mocap"][k, k]) for k in (0, 1)), key=abs)
        text = f"the camera sees {1.0 + off:.2f} of the steps that motion capture sees: look at tracker.scale"
        scale = getattr(tracker, "scale", math.nan)
        yield from _judged("tracker.scale", scale, off, text, scale * (1.0 + off))


def camera_checks(config: BenchConfig, ways: Ways) -> Iterator[CrossCheck]:
    """Compare the wheels with a camera that is all that shows the body: a like error of both does not show.

    Args:
        config: configuration of the bench.
        ways: steps by `odometry` and `tracker`.
    """
    wheels, seen = ways["odometry"], ways["tracker"]
    off = max((_share(wheels[k, k], seen[k, k]) for k in (0, 1)), key=abs)
    if abs(off) <= SAME:
        scale = getattr(config.devices()["tracker"], "scale", math.nan)
        for key, value, given in (
            (_RADIUS, config.robot.wheel_radius_m, "tracker.scale"),
            ("tracker.scale", scale, _RADIUS),
        ):
            yield CrossCheck(key, value, "confirmed", _BY, value, off, within=SAME, given=(given,))
    turn = _share(wheels[2, 2], seen[2, 2])
    if abs(turn) > WRONG and abs(off) <= SAME:
        text = (
            f"the wheels see {1.0 + turn:.2f} of the body's turn, and steps like the camera's: look at "
            f"{' and '.join(_PLACES)}, or at {_RADIUS} and tracker.scale, both by one factor"
        )
        for key in (*_PLACES, _RADIUS, "tracker.scale"):
            table, _, name = key.partition(".")
            value = getattr(getattr(config, table), name)
            yield CrossCheck(key, value, "contradicted", _BY, math.nan, turn, text)
    yield from _places(config, turn, math.inf)
    yield from _direction_by_camera(config, _angle(wheels[0], seen[0]))


def _direction_by_camera(config: BenchConfig, off_rad: float) -> Iterator[CrossCheck]:
    """Direction of a step forwards by the wheels against that by a camera, rad: nothing else shows it.

    On a wall gravity has shown that IMU and camera are turned alike: a plate that bears both is turned.
    """
    devices = config.devices()
    mounts = {_MOUNT: getattr(devices["tracker"], "mount_rotation_wxyz", ())}
    if abs(off_rad) <= _SAME_RAD:
        partly = _confirmed_rad(_MOUNT, mounts[_MOUNT], off_rad)
        yield partly._replace(beside="what gravity and turns show", given=(_ZEROS,))
    if abs(off_rad) <= _WRONG_RAD:
        return
    if config.environment.on_wall and "imu" in devices:
        mounts[_IMU_MOUNT] = getattr(devices["imu"], "mount_rotation_wxyz", ())
    looked_at = f"{' and '.join(mounts)} (a plate that bears both)" if len(mounts) > 1 else _MOUNT
    text = (
        f"by the wheels the body goes {math.degrees(off_rad):+.1f} deg beside what the camera sees: look at "
        f"{looked_at}, or at {_ZEROS}"
    )
    for key, value in {**mounts, _ZEROS: config.alignment.steer_zero_rad}.items():
        yield CrossCheck(key, value, "contradicted", _BY, math.nan, off_rad, text, unit="rad")


def _wheels(config: BenchConfig, wheels: Array, true: Array, steered_off: Array) -> Iterator[CrossCheck]:
    """Radii by the ways, and by turns on straight steps; places by the turn."""
    radii = config.robot.wheel_radius_m
    up, across = (_share(wheels[k, k], true[k, k]) for k in (0, 1))
    beyond = [across] if abs(across) > WRONG else []
    if not -WRONG <= up <= (_CREEP if config.environment.on_wall else WRONG):
        beyond.append(up)
    sides = max(_sides(config, wheels, true, steered_off), key=lambda side: abs(side[0]) - side[1])
    if beyond:
        off = max(beyond, key=abs)
        text = f"the wheels see {1.0 + off:.2f} of the steps of the body: look at {_RADIUS}"
        says = [radius / (1.0 + off) for radius in radii]
        yield CrossCheck(_RADIUS, radii, "contradicted", _BY, says, off, text)
    elif abs(sides[0]) > sides[1]:
        text = (
            f"on a straight step the wheels see {1e3 * sides[0]:+.0f} mrad of turn that the body does not "
            f"make: the wheels of one side have another radius: look at {_RADIUS}"
        )
        yield CrossCheck(_RADIUS, radii, "contradicted", _BY, math.nan, sides[0], text, unit="rad")
    elif max(abs(up), abs(across)) <= SAME:
        off = max(up, across, key=abs)
        yield CrossCheck(_RADIUS, radii, "confirmed", _BY, radii, off, within=SAME)
    yield from _places(config, (1.0 + _share(wheels[2, 2], true[2, 2])) / (1.0 + across) - 1.0, WRONG)


def _places(config: BenchConfig, off: float, wrong: float) -> Iterator[CrossCheck]:
    """Places of the wheels by a turn: it shows their distance from the centre, of x and y together."""
    text = f"the wheels see {1.0 + off:.2f} of the body's turn: look at {' and '.join(_PLACES)}"
    for key, other in zip(_PLACES, _PLACES[::-1], strict=True):
        value = getattr(config.robot, key.partition(".")[2])
        says = [place * (1.0 + off) for place in value]
        yield from _judged(key, value, off, text, says, wrong=wrong, given=(other,))


def _sides(
    config: BenchConfig, wheels: Array, true: Array, steered_off: Array
) -> Iterator[tuple[float, float]]:
    """Turn by the wheels beyond the true one, and its bound, of the steps along x and y, rad.

    Wheels that point another way than their servos say turn the body on a straight step, too.
    """
    for axis, arms in enumerate((config.robot.wheel_x_m, config.robot.wheel_y_m)):
        arm, way_m = np.array(arms), abs(float(true[axis, axis]))
        known = bool(np.isfinite(steered_off).all())
        by_steering = true[axis, axis] * float(arm @ steered_off / (arm @ arm)) if known else 0.0
        unknown = 0.0 if known else way_m * _HORNS_RAD / float(np.abs(arm).mean())
        yield (
            float(wheels[axis, 2] - true[axis, 2] + by_steering),
            _TURN_RAD + _TURN_RAD_M * way_m + unknown,
        )


def _directions(config: BenchConfig, ways: Ways) -> Iterator[CrossCheck]:
    """Directions of steps: by the wheels forwards, as a robot sags only down a wall, and by the camera."""
    by_wheels = _angle(ways["odometry"][0], ways["mocap"][0])
    body = config.of(MocapConfig)
    name = "" if body is None else body.body
    turned = f"by the wheels the body goes {math.degrees(by_wheels):+.1f} deg beside what motion capture sees"
    seen = [_angle(ways["tracker"][k], ways["mocap"][k]) for k in (0, 1)] if "tracker" in ways else []
    by_camera = sum(seen) / len(seen) if seen else math.nan
    zeros = config.alignment.steer_zero_rad
    if abs(by_wheels) <= _SAME_RAD:
        yield _confirmed_rad(_BODY, name, by_wheels)
    elif abs(by_wheels) > _WRONG_RAD:
        text = f"{turned}: look at {_ZEROS}, encoders.zero_rad, {_BODY}"
        keys = ((_ZEROS, zeros),) if abs(by_camera) <= _SAME_RAD else ((_ZEROS, zeros), (_BODY, name))
        for key, value in keys:
            yield CrossCheck(key, value, "contradicted", _BY, math.nan, by_wheels, text, unit="rad")
    if not seen:
        return
    mount = getattr(config.devices()["tracker"], "mount_rotation_wxyz", ())
    if abs(by_camera) <= _SAME_RAD:
        yield _confirmed_rad(_MOUNT, mount, by_camera)._replace(beside="what gravity and turns show")
    elif abs(by_camera) > _WRONG_RAD:
        both = "" if abs(by_wheels) <= _SAME_RAD else f" and {_BODY}"
        text = (
            f"the camera sees steps {math.degrees(by_camera):+.1f} deg beside what motion capture sees: "
            f"look at {_MOUNT}{both}"
        )
        yield CrossCheck(_MOUNT, mount, "contradicted", _BY, math.nan, by_camera, text, unit="rad")


def steered_off(config: BenchConfig, motion: Motion) -> Array:
    """Steering (4,) by the encoders less that by the servos, rad; NaN where it is not known."""
    table, own = config.of(EncodersConfig), config.alignment
    if table is None or table.zero_rad is None:
        return np.full(4, np.nan)
    now = encoder_minus_servo(
        config,
        [s for r in motion.records for s in r.inputs.encoders],
        [s for r in motion.records for s in r.inputs.servos],
    )
    zeros = zip(now, table.sign, table.zero_rad, own.steer_sign, own.steer_zero_rad, strict=True)
    return np.array([wrap(both - sign * zero + steer * horn) for both, sign, zero, steer, horn in zeros])


def _judged(
    key: str,
    value: object,
    off: float,
    text: str,
    says: object,
    *,
    wrong: float = WRONG,
    given: tuple[str, ...] = (),
) -> Iterator[CrossCheck]:
    """A share that confirms or contradicts; nothing between."""
    if abs(off) > wrong:
        yield CrossCheck(key, value, "contradicted", _BY, says, off, text)
    elif abs(off) <= SAME:
        yield CrossCheck(key, value, "confirmed", _BY, value, off, within=SAME, given=given)


def _confirmed_rad(key: str, value: object, off_rad: float) -> CrossCheck:
    return CrossCheck(key, value, "confirmed", _BY, value, off_rad, within=_SAME_RAD, unit="rad")


def _share(seen: float, true: float) -> float:
    return float(seen / true) - 1.0 if true else math.inf


def _angle(seen: Array, true: Array) -> float:
    """Angle of a step against the true one, rad."""
    return cmath.phase(complex(seen[0], seen[1]) * complex(true[0], -true[1]))
