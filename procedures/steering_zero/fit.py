"""Fits steering zeros: from encoder against servo over a sweep, and from the direction of travel.

Encoder minus servo is, per axis, the zero's error, half the backlash with the sign of the direction of
turning, and once and twice per turn the error of an eccentric magnet (ams AS5045 datasheet).
Over a sweep of some 200 degrees these can be distinguished.

Motions in the plane show only the common part of the four zeros: toe and unequal wheel radii turn the body
in the same way in every motion. The common part is measured at the load centre, the point that moves with
the load-weighted mean of the wheels' rolling: there turning has no effect.
"""

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
    """Fit of one steering axis.

    Attributes:
        offset_rad: heading of the wheel minus steering angle with the configured zero.
        uncertainty_rad: half of the 95 % interval.
        backlash_rad: whole backlash.
        eccentricity_rad: amplitude once per turn.
        residual_rad: RMS residual.
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
    """Fit zero, backlash and eccentricity from a sweep.

    Args:
        t_s: (n,) times of the encoder's samples.
        steering_rad: (n,) angle of the servo, bench signs and zeros applied, at these times.
        encoder_rad: (n,) heading of the wheel by the encoder.
        sweeps: number of parts of equal duration in the data; leaving out each in turn gives the
            uncertainty.
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
    """Return prior information on (zero, half backlash, magnet 1, 1, 2, 2), for unit noise of the samples."""
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
    """Result of one straight leg.

    Attributes:
        name: name of the leg.
        way_m: length, m.
        common_rad: direction of travel of the load centre minus the load-weighted mean steering.
        turned_rad_m: turn of the body per metre.
    """

    name: str
    way_m: float
    common_rad: float
    turned_rad_m: float


def judge_leg(name: str, motion: Motion, config: BenchConfig) -> Leg:
    """Compare the direction of travel (motion capture) with the wheel directions while rolling."""
    rolled, truth = wheels(motion), poses(motion, "mocap")
    share, radius = load_shares(config), np.array(config.robot.wheel_radius_m)
    steps = np.diff(rolled.values[:, 0:4], axis=0) * radius
    steering = 0.5 * (rolled.values[1:, 8:12] + rolled.values[:-1, 8:12])
    by_wheels = np.array([np.sum(share * steps * np.cos(steering)), np.sum(share * steps * np.sin(steering))])
    pose = truth.values
    middle = 0.5 * (pose[1:, 2] + pose[:-1, 2])
    moved = np.array([rotation2(-a) @ d for a, d in zip(middle, np.diff(pose[:, :2], axis=0), strict=True)])
    turned = float(pose[-1, 2] - pose[0, 2])
    x = float(share @ np.array(config.robot.wheel_x_m))
    y = float(share @ np.array(config.robot.wheel_y_m))
    went = moved.sum(axis=0) + turned * np.array([-y, x])
    angle = math.atan2(went[1], went[0]) - math.atan2(by_wheels[1], by_wheels[0])
    length_m = float(np.hypot(*went))
    return Leg(name, length_m, float(wrap_array(angle)), turned / length_m)


def toe_turn_rad_m(config: BenchConfig, offset_rad: Array, alpha_rad: float) -> float:
    """Return the turn per metre caused by zeros on a straight leg along body direction `alpha_rad`."""
    share = load_shares(config)
    x, y = np.array(config.robot.wheel_x_m), np.array(config.robot.wheel_y_m)
    x, y = x - share @ x, y - share @ y
    lever = x * math.cos(alpha_rad) + y * math.sin(alpha_rad)
    return float(np.sum(share * lever * offset_rad) / np.sum(share * (x**2 + y**2)))
