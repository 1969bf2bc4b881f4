"""Samples wheels and ground truth of a recording at given instants.

The two logs of a drive have different stamps and gaps. Wheels are integrated over all their own rows, so
never in one step across a gap of the ground truth. Ground truth is known only where it has rows.
"""

import numpy as np

from hil.core.errors import DataError, UsageError
from hil.core.geometry import Array, Bools
from hil.core.interpolation import between_samples
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import wheel_vectors

SIGNALS = ("position", "velocity")
LONGEST_GAP_S = 0.25
"""Longest gap across which dense ground truth is interpolated."""
_SLOW_S = 0.06
"""Ground truth with a longer median time between rows is not interpolated at all."""
_LOG_PERIOD_S = 0.016


def interpolate(at_s: Array, t_s: Array, values: Array) -> Array:
    """Interpolate the columns of `values` linearly, (m, k).

    Args:
        at_s: (m,) instants, s.
        t_s: (n,) times of the rows, s.
        values: (n, k) values of the rows.
    """
    return np.column_stack([np.interp(at_s, t_s, column) for column in values.T])


def truth_window(recording: Recording) -> tuple[Array, Array]:
    """Ground truth rows within the wheel log: stamps (n,) and poses (n, 3)."""
    inside = (recording.truth_t_s >= recording.t_s[0]) & (recording.truth_t_s <= recording.t_s[-1])
    return recording.truth_t_s[inside], recording.truth_pose[inside]


def wheel_edges(recording: Recording, begin_s: float, end_s: float) -> Array:
    """Edges (k + 1,), s: `begin_s`, the wheel rows after it, up to the first row at or after `end_s`.

    Args:
        recording: recording with the wheel rows.
        begin_s: first edge, within the wheel log.
        end_s: later instant within the wheel log.
    """
    first = int(np.searchsorted(recording.t_s, begin_s, side="right"))
    last = int(np.searchsorted(recording.t_s, end_s, side="left"))
    return np.concatenate([[begin_s], recording.t_s[first : last + 1]])


def wheel_steps(recording: Recording, at_s: Array, signal: str) -> tuple[Array, Array]:
    """Wheel rotation (n - 1, 4) rad and mean steering angle (n - 1, 4) rad between the instants `at_s`.

    Args:
        recording: recording with wheel and steering angles.
        at_s: (n,) instants, s.
        signal: `position` or `velocity`.

    Raises:
        DataError: the velocity register is requested but was not recorded.
        UsageError: another signal.
    """
    if signal not in SIGNALS:
        raise UsageError(f"signal {signal!r}", expected="one of " + ", ".join(SIGNALS))
    steering = interpolate(at_s, recording.t_s, recording.steering_rad)
    middle = 0.5 * (steering[1:] + steering[:-1])
    if signal == "position":
        return np.diff(interpolate(at_s, recording.t_s, recording.wheel_angle_rad), axis=0), middle
    if not recording.has_rates:
        raise DataError(
            recording.name, "has no wheel rates", expected="w1..w4", remedy="use --signal position"
        )
    rate = interpolate(at_s, recording.t_s, recording.wheel_rate_rad_s)
    return 0.5 * (rate[1:] + rate[:-1]) * np.diff(at_s)[:, None], middle


def block_vectors(recording: Recording, edges_s: Array, signal: str) -> Array:
    """Wheel vectors dphi_i (cos d_i, sin d_i) summed between edges, shape (n, 8), rad.

    Increments are formed at least every 16 ms, the period of the log, so that the steering may change within
    a block of any length.

    Args:
        recording: recording with wheel and steering angles.
        edges_s: (n + 1,) edges of the blocks, s.
        signal: `position` or `velocity`.
    """
    lasts_s = np.diff(edges_s)
    fine = np.maximum(1, np.round(lasts_s / _LOG_PERIOD_S)).astype(np.int64)
    first = np.concatenate([[0], np.cumsum(fine)])
    part = (np.arange(first[-1]) - np.repeat(first[:-1], fine)) / np.repeat(fine, fine)
    inner = np.repeat(edges_s[:-1], fine) + np.repeat(lasts_s, fine) * part
    rotation, steering = wheel_steps(recording, np.append(inner, edges_s[-1]), signal)
    return np.add.reduceat(wheel_vectors(rotation, steering), first[:-1], axis=0)


def is_slow(stamps_s: Array) -> bool:
    """Whether rows (n,), s, are too far apart to interpolate between them."""
    return len(stamps_s) > 1 and float(np.median(np.diff(stamps_s))) > _SLOW_S


def beside_rows(at_s: Array, truth_s: Array, truth: Array) -> Array:
    """Poses (n, 3) at the instants (n,) nearest to rows of ground truth; NaN at the other instants.

    Each pose is interpolated between the rows (m,), (m, 3); the distance to the row is short.
    """
    between = between_samples(at_s, truth_s, truth, longest=np.inf)
    behind = np.clip(np.searchsorted(at_s, truth_s), 1, len(at_s) - 1)
    nearest = np.where(truth_s - at_s[behind - 1] < at_s[behind] - truth_s, behind - 1, behind)
    out = np.full_like(between, np.nan)
    out[nearest] = between[nearest]
    return out


def truth_at(at_s: Array, truth_s: Array, truth: Array, longest_s: float, edge_s: float = 0.0) -> Array:
    """Ground truth (n, 3) at instants (n,) for a table, NaN where it is not known.

    Args:
        at_s: instants in order, s.
        truth_s: (m,) times of the rows, s.
        truth: (m, 3) poses of the rows.
        longest_s: longest gap across which dense rows are interpolated; for slow rows see `beside_rows`.
        edge_s: time before the first and after the last dense row for which that row holds.
    """
    if is_slow(truth_s) and len(at_s) > 1:
        return beside_rows(at_s, truth_s, truth)
    return between_samples(at_s, truth_s, truth, longest=longest_s, before=edge_s, after=edge_s)


def checked_edges(recording: Recording, block_s: float) -> tuple[Array, Array, Bools]:
    """Edges (n + 1,), s, of blocks, ground truth (n, 3) at their ends, and whether it is known (n,).

    It is known between rows at most `LONGEST_GAP_S` apart. Where the median distance of the rows is above
    0.06 s, an edge is moved to a row less than half a block away, and the truth is known only there.
    Elsewhere the truth is interpolated linearly, which must not be used for comparison.

    Args:
        recording: recording with wheels and ground truth.
        block_s: typical length of a block, s.
    """
    truth_s, truth = truth_window(recording)
    count = max(1, int((truth_s[-1] - truth_s[0]) / block_s))
    edges_s = truth_s[0] + np.arange(count + 1) * block_s
    behind = np.clip(np.searchsorted(truth_s, edges_s), 1, len(truth_s) - 1)
    if is_slow(truth_s):
        near = np.where(edges_s - truth_s[behind - 1] < truth_s[behind] - edges_s, behind - 1, behind)
        known = np.abs(truth_s[near] - edges_s) < 0.5 * block_s
        edges_s = np.where(known, truth_s[near], edges_s)
    else:
        known = truth_s[behind] - truth_s[behind - 1] <= LONGEST_GAP_S
        known |= np.isin(edges_s, truth_s)
    return edges_s, interpolate(edges_s[1:], truth_s, truth), known[1:]
