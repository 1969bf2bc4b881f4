"""The camera's scale: from whole legs, rest to rest, and how much it differs from one session to the next.

Half-second intervals know the mount best and the scale badly: each has the noise of both its ends on a few
centimetres. A leg has it once, on all of its way, and at rest it averages out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.special import stdtrit

from hil.config.robot_record import RobotRecord
from hil.core.geometry import Array
from hil.procedure import Context
from hil.procedures.tracker_extrinsics.driving import Leg
from hil.procedures.tracker_extrinsics.hand_eye import Extrinsics, Truth

_FEWEST_LEGS, _SHORTEST_M, _REST_S = 4, 0.1, 0.1
_SCALE = 5
_SESSIONS_ASSUMED = 3


def by_whole_legs(legs: Sequence[Leg], found: Extrinsics) -> Extrinsics:
    """With the scale of the legs that went anywhere, where at least four did and they know it better.

    Args:
        legs: each from rest to rest.
        found: by half-second intervals; its mount counts.
    """
    ways = np.array([w for w in (_ways(leg, found) for leg in legs) if w is not None])
    if len(ways) < _FEWEST_LEGS:
        return found
    seen_m, true_m = ways.T
    weight = float(true_m @ true_m)
    scale = float(true_m @ seen_m) / weight
    rest = seen_m - scale * true_m
    sigma = math.sqrt(float(rest @ rest) / (len(ways) - 1) / weight)
    half = float(stdtrit(len(ways) - 1, 0.975)) * sigma
    if half > found.scale_uncertainty:
        return found
    covariance = found.covariance.copy()
    covariance[_SCALE, :] = covariance[:, _SCALE] = 0.0
    covariance[_SCALE, _SCALE] = (0.5 * half) ** 2
    return replace(found, scale=scale, scale_uncertainty=half, covariance=covariance)


def _ways(leg: Leg, found: Extrinsics) -> tuple[float, float] | None:
    """Distance of the leg's ends by the camera, and of the same places by motion capture and mount, m."""
    truth, seen = leg.truth, leg.seen
    if len(truth) < 2 or len(seen) < 2:
        return None
    end_s = min(truth.t_s[-1], seen.t_s[-1])
    ends = [(leg.begin_s, leg.begin_s + _REST_S), (end_s - _REST_S, end_s)]
    if any(not np.any((s.t_s >= a) & (s.t_s <= b)) for s in (truth, seen) for a, b in ends):
        return None
    by_camera = [seen.between(a, b)[0:3] for a, b in ends]
    by_truth = [_camera_at(Truth(truth), truth.t_s, a, b, found) for a, b in ends]
    true_m = float(np.linalg.norm(by_truth[1] - by_truth[0]))
    return (float(np.linalg.norm(by_camera[1] - by_camera[0])), true_m) if true_m > _SHORTEST_M else None


def _camera_at(truth: Truth, t_s: Array, begin_s: float, end_s: float, found: Extrinsics) -> Array:
    """(2,) mean place of the camera in the wall frame over a rest."""
    pose = truth.pose(t_s[(t_s >= begin_s) & (t_s <= end_s)])
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x, y = found.position_m
    where = np.column_stack([pose[:, 0] + c * x - s * y, pose[:, 1] + s * x + c * y])
    return np.asarray(where.mean(axis=0), dtype=np.float64)


def session_spread(ctx: Context, scale: float) -> float:
    """Standard deviation of the camera's scale from one session to the next.

    Assumed at first (the parameter, worth three sessions); every earlier version of the record adds to it.
    """
    assumed, folder = ctx.parameters.session_spread, ctx.source.config.record.folder
    found = [scale]
    if folder is not None:
        kept = (v.file.parts.get("camera") for v in RobotRecord(Path(folder)).history().versions)
        found += {p.measured: p.figures["scale"].value for p in kept if p and "scale" in p.figures}.values()
    off = np.array(found) - np.mean(found)
    worth = _SESSIONS_ASSUMED + len(found) - 1
    return math.sqrt((_SESSIONS_ASSUMED * assumed**2 + float(off @ off)) / worth)
