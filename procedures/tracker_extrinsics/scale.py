"""The camera's scale from whole legs, rest to rest, and its change from one session to the next.

Half-second intervals determine the mount well and the scale poorly: each has the noise of both ends over a
few centimetres. A leg has this noise once over its whole length, and averages it at rest.
"""

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
    """Return `found` with the scale from whole legs, if at least four moved and this scale is more accurate.

    Args:
        legs: legs from rest to rest.
        found: result of the half-second intervals; its mount is used.
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
    """Return the distance of the leg's ends by the camera, and by motion capture and mount, m."""
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
    """Return the mean position (2,) of the camera in the wall frame over a rest."""
    pose = truth.pose(t_s[(t_s >= begin_s) & (t_s <= end_s)])
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x, y = found.position_m
    where = np.column_stack([pose[:, 0] + c * x - s * y, pose[:, 1] + s * x + c * y])
    return np.asarray(where.mean(axis=0), dtype=np.float64)


def session_spread(ctx: Context, scale: float) -> float:
    """Return the standard deviation of the camera's scale from one session to the next.

    The assumed value (the parameter) counts as three sessions; every earlier version of the record is added.
    """
    assumed, folder = ctx.parameters.session_spread, ctx.source.config.record.folder
    found = [scale]
    if folder is not None:
        kept = (v.file.parts.get("camera") for v in RobotRecord(Path(folder)).history().versions)
        found += {p.measured: p.figures["scale"].value for p in kept if p and "scale" in p.figures}.values()
    off = np.array(found) - np.mean(found)
    worth = _SESSIONS_ASSUMED + len(found) - 1
    return math.sqrt((_SESSIONS_ASSUMED * assumed**2 + float(off @ off)) / worth)
