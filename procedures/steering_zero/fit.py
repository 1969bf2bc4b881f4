"""Steering zeros: from encoder against servo over a sweep, and from the direction in which the body goes.

Encoder minus servo is, per axis, the zero's error, half the backlash with the sign of the direction of
turning, and once and twice per turn the error of an eccentric magnet (ams AS5045 datasheet).
Over a sweep of some 200 degrees these can be distinguished.

Of the four zeros, motions in the plane only show their common part: toe and unequal wheel radii turn the
body alike, whatever is driven. The common part is seen at the load
centre, the point that moves with the load-weighted mean of the wheels' rolling: there turning does not
matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.bench.loop_settings import load_shares
from hil.config.bench import BenchConfig
from hil.core.geometry import Array, rotation2, wrap_array
from hil.loop.driven_motion import Motion
from hil.procedure.sample_arrays import poses, wheels

_MAGNET_SIGMA_RAD = math.radians(0.5)
_TURNING_RAD_S = 0.05


@dataclass(frozen=True)
class AxisFit:
    """One steering axis.

    Attributes:
        offset_rad: heading of the wheel minus steering angle as the bench believes it.
        uncertainty_rad: half of the 95 % interval.
        backlash_rad: whole backlash.
        eccentricity_rad: amplitude once per turn.
        residual_rad: RMS of what is left.
        steering_rad, difference_rad, fitted_rad: (n,) for a figure; `fitted` is without backlash.
    """

    offset_rad: float
    uncertainty_rad: float
    backlash_rad: float
    eccentricity_rad: float
    residual_rad: float
    steering_rad: Array
    difference_rad: Array
    fitted_rad: Array


def fit_axis(t_s: Array, steering_rad: Array, encoder_rad: Array, sweeps: int) -> AxisFit:
    """Zero, backlash and eccentricity from a sweep.

    Args:
        t_s: (n,) of the encoder's samples.
        steering_rad: (n,) by the servo, bench signs and zeros applied, at these times.
        encoder_rad: (n,) heading of the wheel by the encoder.
        sweeps: how many parts of equal time the data consist of; the spread of the result when each
            is left out in turn says how well it is known.
    """
    rate = np.gradient(steering_rad, t_s)
    turning = np.abs(rate) > _TURNING_RAD_S
    t, theta, direction = t_s[turning], steering_rad[turning], np.sign(rate[turning])
    difference = wrap_array(encoder_rad[turning] - theta)
    design = np.column_stack(
        [np.ones_like(theta), -direction, np.sin(theta), np.cos(theta), np.sin(2 * theta), np.cos(2 * theta)]
    )
    whole = _solve(design, difference)
    part = np.minimum(((t - t[0]) / (t[-1] - t[0]) * sweeps).astype(int), sweeps - 1)
    without = [_solve(design[part != k], difference[part != k])[0] for k in range(sweeps)]
    spread = math.sqrt((sweeps - 1) / sweeps * float(np.sum((np.array(without) - np.mean(without)) ** 2)))
    residual = difference - design @ whole
    return AxisFit(
        float(whole[0]),
        2.0 * math.hypot(spread, _formal(design, residual)),
        2.0 * float(whole[1]),
        math.hypot(whole[2], whole[3]),
        float(np.sqrt(np.mean(residual**2))),
        theta,
        difference,
        design[:, [0, 2, 3, 4, 5]] @ whole[[0, 2, 3, 4, 5]],
    )


def _weights(rows: int) -> Array:
    """Prior information on (zero, half backlash, magnet 1, 1, 2, 2), for unit noise of the samples' size."""
    noise_over_sigma = math.radians(0.1) / _MAGNET_SIGMA_RAD
    return np.diag([0.0, 0.0, *[noise_over_sigma**2] * 4]) * min(1.0, rows)


def _solve(design: Array, values: Array) -> Array:
    normal = design.T @ design + _weights(len(values))
    return np.asarray(np.linalg.solve(normal, design.T @ values), dtype=np.float64)


def _formal(design: Array, residual: Array) -> float:
    normal = design.T @ design + _weights(len(residual))
    return float(np.std(residual) * math.sqrt(np.linalg.inv(normal)[0, 0]))


@dataclass(frozen=True)
class Leg:
    """What one straight leg showed.

    Attributes:
        name: of the leg.
        way_m: length.
        common_rad: direction of travel of the load centre minus the load-weighted mean steering.
        turned_rad_m: turn of the body per metre.
    """

    name: str
    way_m: float
    common_rad: float
    turned_rad_m: float


def judge_leg(name: str, motion: Motion, config: BenchConfig) -> Leg:
    """Compare where the body went (motion capture) with where its wheels pointed while they rolled."""
    rolled, truth = wheels(motion), poses(motion, "mocap")
    share, radius = load_shares(config), np.array(config.robot.wheel_radius_m)
    steps = np.diff(rolled.values[:, 0:4], axis=0) * radius
    steering = 0.5 * (rolled.values[1:, 8:12] + rolled.values[:-1, 8:12])
    believed = np.array([np.sum(share * steps * np.cos(steering)), np.sum(share * steps * np.sin(steering))])
    pose = truth.values
    middle = 0.5 * (pose[1:, 2] + pose[:-1, 2])
    moved = np.array([rotation2(-a) @ d for a, d in zip(middle, np.diff(pose[:, :2], axis=0), strict=True)])
    turned = float(pose[-1, 2] - pose[0, 2])
    x = float(share @ np.array(config.robot.wheel_x_m))
    y = float(share @ np.array(config.robot.wheel_y_m))
    went = moved.sum(axis=0) + turned * np.array([-y, x])
    angle = math.atan2(went[1], went[0]) - math.atan2(believed[1], believed[0])
    length_m = float(np.hypot(*went))
    return Leg(name, length_m, float(wrap_array(angle)), turned / length_m)


def toe_turn_rad_m(config: BenchConfig, offset_rad: Array, alpha_rad: float) -> float:
    """Turn per metre that zeros cause on a straight leg along body direction `alpha_rad`."""
    share = load_shares(config)
    x, y = np.array(config.robot.wheel_x_m), np.array(config.robot.wheel_y_m)
    x, y = x - share @ x, y - share @ y
    lever = x * math.cos(alpha_rad) + y * math.sin(alpha_rad)
    return float(np.sum(share * lever * offset_rad) / np.sum(share * (x**2 + y**2)))
