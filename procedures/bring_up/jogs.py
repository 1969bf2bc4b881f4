"""Small motions of single joints: measures in which direction a wheel pushes, and which axis turns.

A jog goes out and back. The difference of the body motions out and back cancels motion in a constant
direction (sag on a wall), so that a tenth of a millimetre is enough to detect a direction. Every rest is
observed for longer than gaps of motion capture (at most 0.2 s, as emulated).
"""

import math
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from hil.bench import Bench
from hil.config.bench import BenchConfig
from hil.core.geometry import Array
from hil.core.signals import WHEELS
from hil.loop.driven_motion import Motion
from hil.procedure.sample_arrays import Series, encoders, inertial, integrated, poses, wheels
from hil.procedure.scripted_joints import Stretch, play
from hil.procedures.bring_up.plane import off_plane

_OUT_S, _REST_S, _LOOK_S = 0.4, 0.45, 0.3
_SETTLE_S = 1.5
_LIKE = 0.5
"""Cosine of pushes, or share of a turn, above which two joints count as the same."""
_LESS = 0.3
"""Difference by which each of two exchanged joints is less like itself: its own turn is small on a wall."""


@dataclass(frozen=True)
class DriveJogs:
    """Result of one round of drive jogs at one steering angle.

    Attributes:
        steering_rad: commanded steering angle of all wheels.
        expected, found: (4, 3) body displacement per wheel as unit vectors; the turn is scaled by the
            wheels' distance from the centre.
        moved_m: (4,) length of the displacement: half of out minus back.
        moved: (4, 3) displacement in body axes, m, m, rad.
        felt_rad: (4,) turn by the gyro; NaN without one.
        off_plane: sensors by which the body leaves the plane that it rolls on.
    """

    steering_rad: float
    expected: Array
    found: Array
    moved_m: Array
    moved: Array
    felt_rad: Array
    off_plane: tuple[str, ...] = ()

    def agreement(self) -> Array:
        """Return the (4,) cosine between found and expected push: 1 for the right direction, -1 reversed."""
        return np.asarray(np.diag(self.agreements()), dtype=np.float64)

    def agreements(self) -> Array:
        """Return the (4, 4) cosine `[found, expected]` between the pushes of each pair of wheels."""
        return np.asarray(self.found @ self.expected.T, dtype=np.float64)


@dataclass(frozen=True)
class SteerJogs:
    """Turn of every axis over the commanded turn of one axis: `[moved, commanded]`, (4, 4) each.

    The values of missing encoders are NaN.
    """

    servo: Array
    encoder: Array


def jog_steering(bench: Bench, angle_rad: float) -> SteerJogs:
    """Turn the steering axes out and back, one after the other."""
    pose = bench.settle(0.3)
    stretches, marks, t_s = [], [], 0.0
    for wheel in range(4):
        turned = np.zeros(4)
        turned[wheel] = angle_rad
        for goal in (turned, -turned):
            stretches.append(Stretch(_OUT_S + _REST_S, steering_rad=goal, ramp=False))
            t_s += _OUT_S + _REST_S
            marks.append(t_s)
    stretches.append(Stretch(0.5, steering_rad=np.zeros(4), ramp=False))
    motion = play(bench, stretches, pose, np.zeros(4))
    servo = _responses(wheels(motion), slice(8, 12), marks, angle_rad)
    if not bench.has("encoders"):
        return SteerJogs(servo, np.full((4, 4), np.nan))
    return SteerJogs(servo, _responses(encoders(motion, bench.config), slice(0, 4), marks, angle_rad))


def _responses(series: Series, columns: slice, marks: list[float], angle_rad: float) -> Array:
    """Return the turn of every axis over the commanded turn, from the ends of the jogs to either side."""
    rows = [series.between(t - _LOOK_S, t)[columns] for t in marks]
    turned = [rows[2 * k] - rows[2 * k + 1] for k in range(4)]
    return np.asarray(np.array(turned).T / (2.0 * angle_rad), dtype=np.float64)


def jog_drives(bench: Bench, source: str, steering_rad: float, rate_rad_s: float) -> DriveJogs:
    """Roll the wheels out and back, one after the other, all steered to one angle.

    Args:
        bench: open bench with enabled servos.
        source: device whose poses show the body's motion, `mocap` or `tracker`.
        steering_rad: steering angle of all wheels.
        rate_rad_s: rate of the wheel.
    """
    pose = bench.settle(0.3)
    angles = np.full(4, steering_rad)
    now = wheels(bench.observe(0.1, feedback="odometry")).values[-1, 8:12]
    play(bench, [Stretch(_SETTLE_S, steering_rad=angles)], pose, now)
    stretches, marks, t_s = [Stretch(_REST_S, steering_rad=angles)], [_REST_S], _REST_S
    for wheel in range(4):
        rate = np.zeros(4)
        rate[wheel] = rate_rad_s
        for way in (rate, -rate):
            stretches += [Stretch(_OUT_S, way), Stretch(_REST_S)]
            t_s += _OUT_S + _REST_S
            marks.append(t_s)
    motion = play(bench, stretches, pose, angles)
    seen = poses(motion, source)
    at = np.array([seen.between(t - _LOOK_S, t) for t in marks])
    reach = math.hypot(*_arms(bench.config).mean(axis=0))
    steps = np.diff(at, axis=0) * np.array([1.0, 1.0, reach])
    moved = 0.5 * (steps[0::2] - steps[1::2])
    size = np.linalg.norm(moved, axis=1)
    expected = expected_push(bench.config, steering_rad, reach)
    heading = float(pose[2])
    c, s = math.cos(heading), math.sin(heading)
    moved = moved @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    found = moved / np.maximum(size, 1e-9)[:, None]
    return DriveJogs(
        steering_rad,
        expected,
        found,
        size,
        moved / [1.0, 1.0, reach],
        _felt(bench, motion, marks),
        off_plane(source, motion, bench.config),
    )


def _felt(bench: Bench, motion: Motion, marks: list[float]) -> Array:
    """Return the (4,) turn by the gyro: half of out minus back, each from mark to mark."""
    if not bench.has("imu"):
        return np.full(4, np.nan)
    data = inertial(motion)
    turned = np.interp(marks, data.t_s, integrated(data.t_s, data[0]))
    steps = np.diff(turned)
    return np.asarray(0.5 * (steps[0::2] - steps[1::2]), dtype=np.float64)


def _arms(config: BenchConfig) -> Array:
    return np.asarray(np.abs(np.array([config.robot.wheel_x_m, config.robot.wheel_y_m]).T), dtype=np.float64)


def expected_push(config: BenchConfig, steering_rad: float, reach_m: float) -> Array:
    """Return (4, 3) unit vectors: body displacement by a push of each wheel along its heading."""
    x, y = np.array(config.robot.wheel_x_m), np.array(config.robot.wheel_y_m)
    c, s = math.cos(steering_rad), math.sin(steering_rad)
    push = np.stack([np.full(4, c), np.full(4, s), (x * s - y * c) / reach_m], axis=1)
    return np.asarray(push / np.linalg.norm(push, axis=1)[:, None], dtype=np.float64)


@dataclass(frozen=True)
class Signs:
    """Signs found, relative to the configured ones: (4,) of 1, -1, or 0 if unclear."""

    drive: Array
    steer: Array
    encoder: Array


def find_signs(straight: DriveJogs, across: DriveJogs, steer: SteerJogs) -> Signs:
    """Find drives, steering axes and encoders whose direction differs from the configured signs.

    A reversed drive pushes backwards at every steering angle; a wheel with a reversed steering axis
    pushes backwards only when steered across.
    """
    first, second = _sign(straight.agreement()), _sign(across.agreement())
    turned = _sign(np.diag(steer.encoder))
    return Signs(first, first * second, first * second * turned)


def exchanged_drives(straight: DriveJogs, across: DriveJogs) -> dict[int, int]:
    """Return the drives that each push in the direction expected of another: place -> place of that one."""
    return _order(np.minimum(straight.agreements(), across.agreements()))


def exchanged_axes(steer: SteerJogs) -> dict[int, int]:
    """Return the encoders that each turn when another axis is commanded: place -> place of that axis."""
    return _order(steer.encoder)


def _order(alike: Array) -> dict[int, int]:
    """Return the places that clearly match another, in the best order of a (4, 4) matrix, 1 for a match."""
    alike = np.nan_to_num(alike)
    best = max(permutations(range(4)), key=lambda order: sum(alike[k, order[k]] for k in range(4)))
    moved = {k: other for k, other in enumerate(best) if k != other}
    own = max((alike[k, k] for k in moved), default=0.0)
    clear = all(alike[k, other] > max(own, _LIKE - _LESS) + _LESS for k, other in moved.items())
    return moved if clear else {}


def _sign(cosine: Array) -> Array:
    clear = np.abs(np.nan_to_num(cosine)) > 0.3
    return np.asarray(np.where(clear, np.sign(np.nan_to_num(cosine)), 0.0), dtype=np.float64)


def reversed_names(found: Array, what: str) -> list[str]:
    """Return the names of the joints whose sign is reversed or unclear."""
    return [
        f"{what} {w} {'unclear' if s == 0 else 'reversed'}"
        for w, s in zip(WHEELS, found, strict=True)
        if s != 1
    ]
