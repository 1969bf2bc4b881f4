"""Errors of estimates against motion capture, and both as trajectories at the same instants."""

from collections.abc import Mapping

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.geometry import Array, wrap_array
from hil.loop.driven_motion import HELD_S, Motion
from hil.robot.odometry import displacements, sample_path
from hil.robot.trajectory_errors import aligned, pairs_by_path, relative_errors

RELATIVE_M = 0.1
"""Way over which relative pose errors are taken."""
_ERRORS = (
    "rmse_position_m",
    "rmse_theta_rad",
    "final_position_m",
    "max_position_m",
    "rpe_position_m",
    "rpe_theta_rad",
)


def samples_of(motion: Motion) -> tuple[Array, Array]:
    """Valid samples of motion capture: s since the first cycle (m,) and poses (m, 3), in order of time."""
    found = [m for r in motion.records for m in r.measurements.mocap if m.valid]
    begin_ns = motion.records[0].inputs.t_ns if motion.records else 0
    at_s = np.array([(m.stamp.t_ns - begin_ns) / NS_PER_S for m in found], dtype=np.float64)
    order = np.argsort(at_s, kind="stable")
    return at_s[order], np.array([m.pose for m in found], dtype=np.float64).reshape(-1, 3)[order]


def matched(motion: Motion) -> tuple[Array, Array, Array]:
    """Stamps (m,), s, poses of motion capture (m, 3), and the estimate (m, 3) at them.

    Between two cycles the estimate is extrapolated with constant twist.
    """
    at_s, poses = samples_of(motion)
    cycles_s, estimate = motion.t_s, motion.estimate
    inside = (at_s >= 0.0) & (at_s <= cycles_s[-1]) if len(cycles_s) > 1 else at_s < at_s
    at_s, poses = at_s[inside], poses[inside]
    if not len(at_s):
        return at_s, poses, poses
    return at_s, poses, sample_path(at_s, cycles_s, estimate, displacements(estimate))


def errors(motion: Motion, align: str = "none", over_m: float = RELATIVE_M) -> dict[str, float]:
    """Errors against motion capture at its own samples, as `hil evaluate` has them; NaN without it.

    The error at the end is that of the last sample; NaN if that sample lies `HELD_S`, and more than two
    sample intervals, before the end.

    Args:
        motion: motion with its estimate.
        align: alignment of the estimate, see `table`.
        over_m: way over which relative pose errors are taken, m.

    Returns:
        `rmse_position_m`, `rmse_theta_rad`, `final_position_m`, `max_position_m`, and the relative
        `rpe_position_m`, `rpe_theta_rad`.
    """
    at_s, poses, estimate = matched(motion)
    known = np.flatnonzero(np.isfinite(estimate - poses).all(axis=1))
    if not len(known):
        return dict.fromkeys(_ERRORS, np.nan)
    true = poses[known]
    estimate = aligned(estimate[known], true, align)
    difference = estimate - true
    distance_m: Array = np.hypot(difference[:, 0], difference[:, 1])
    apart_s = float(np.median(np.diff(at_s))) if len(at_s) > 1 else 0.0
    saw_end = motion.t_s[-1] - at_s[known[-1]] < max(HELD_S, 2.0 * apart_s)
    relative = relative_errors(estimate, true, pairs_by_path(true, over_m))
    figures = (
        _rms(distance_m),
        _rms(wrap_array(difference[:, 2])),
        float(distance_m[-1]) if saw_end else np.nan,
        float(distance_m.max()),
        *map(_rms, relative),
    )
    return dict(zip(_ERRORS, figures, strict=True))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else np.nan


def paths_of(motions: Mapping[str, Motion]) -> tuple[Array, dict[str, Array]]:
    """Instants (n,), s since the first cycle, and poses (n, 3) of the truth and of each motion by name.

    The instants are those of motion capture; without it they are the cycles, and there is no truth.
    """
    found = {name: matched(motion) for name, motion in motions.items()}
    at_s, truth, _ = next(iter(found.values()))
    if len(at_s):
        return at_s, {"truth": truth, **{name: estimate for name, (_, _, estimate) in found.items()}}
    return next(iter(motions.values())).t_s, {name: one.estimate for name, one in motions.items()}
