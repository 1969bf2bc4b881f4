"""Cross-validates a calibration: leaves one repetition or one motion out, and predicts it."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from hil.calibration.evaluation import Track, metrics, track_all
from hil.calibration.fitting import fit
from hil.calibration.problem import Setting
from hil.calibration.solvers import Progress
from hil.core.geometry import Array
from hil.datasets.fit_blocks import Blocks
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import WheelGeometry

Table = dict[str, dict[str, float]]
_NEAR_START_M = 0.1
_UNLIKE, _TIMES_USUAL, _ROWS = 0.01, 6.0, 20
_KEYS = ("rmse_position_m", "rmse_theta_rad", "final_position_m")


def repetition_numbers(motions: Sequence[str]) -> list[int]:
    """Number of each repetition, 0, 1, 2, ..., within its motion, in the order given."""
    seen: dict[str, int] = {}
    out = []
    for motion in motions:
        seen[motion] = seen.get(motion, -1) + 1
        out.append(seen[motion])
    return out


def left_out(
    recordings: Sequence[Recording],
    blocks: Blocks,
    setting: Setting,
    nominal: WheelGeometry,
    start: Array,
    groups: Sequence[object],
    progress: Progress | None = None,
) -> list[Track]:
    """Odometry of every recording by a fit without its group; left out where the group is everything.

    Folds are fitted in parallel; the results do not depend on this.

    Args:
        recordings: the runs, in the order of `blocks`.
        blocks: the same runs, reduced.
        setting: setting of the fit.
        nominal: prior mean.
        start: parameters (m,) to start from, see `fitting.fit`.
        groups: one label per recording; each label in turn is left out.
        progress: called with (done, total) folds.
    """
    labels = list(dict.fromkeys(groups))

    def fold(label: object) -> dict[int, Track]:
        inside = [k for k, g in enumerate(groups) if g != label]
        if not inside:
            return {}
        geometry = fit(blocks.subset(inside), setting, nominal, start=start).geometry
        outside = [k for k, g in enumerate(groups) if g == label]
        runs = track_all([recordings[k] for k in outside], geometry, setting.model, setting.signal)
        return dict(zip(outside, runs, strict=True))

    found: dict[int, Track] = {}
    pool = ThreadPoolExecutor(min(len(labels), os.cpu_count() or 1))
    try:
        for number, tracks in enumerate(pool.map(fold, labels), start=1):
            found.update(tracks)
            if progress is not None:
                progress(number, len(labels))
    finally:  # on an interrupt, folds that have not started are cancelled
        pool.shutdown(cancel_futures=True)
    return [found[k] for k in sorted(found)]


def score(
    recordings: Sequence[Recording],
    geometry: WheelGeometry,
    setting: Setting,
    correction: Array | None = None,
) -> Table:
    """Errors by motion for a geometry, or for a twist correction (3, 3) applied after it.

    Args:
        recordings: recordings to evaluate.
        geometry: wheel parameters.
        setting: forward model and signal.
        correction: (3, 3) correction of the body twist, applied after the geometry.
    """
    return table_of(track_all(recordings, geometry, setting.model, setting.signal, correction))


@dataclass(frozen=True)
class Deployed:
    """Errors by motion of one calibration, applied as wheel parameters and as a twist correction."""

    parameters: Table
    twist: Table


def deployed(
    recordings: Sequence[Recording],
    geometry: WheelGeometry,
    nominal: WheelGeometry,
    correction: Array,
    setting: Setting,
) -> Deployed:
    """Score both ways to apply a calibration: `geometry`, or `correction` (3, 3) of nominal odometry.

    Args:
        recordings: recordings to evaluate.
        geometry: fitted geometry.
        nominal: geometry that the correction belongs to.
        correction: (3, 3) correction of the body twist.
        setting: forward model and signal.
    """
    return Deployed(
        score(recordings, geometry, setting),
        score(recordings, nominal, replace(setting, model="exact"), correction),
    )


def repeatability(recordings: Sequence[Recording]) -> dict[str, float]:
    """Non-systematic error by motion: spread of the repetitions' end points, m; NaN for a single run.

    Only repetitions with similar end points count together: a line driven in reverse ends elsewhere.
    """
    ends: dict[str, list[list[Array]]] = {}
    for group in _alike(recordings):
        alike = [_end_m(recordings[k].truth_pose) for k in group]
        ends.setdefault(recordings[group[0]].motion, []).append(alike)
    return {motion: _spread(groups) for motion, groups in ends.items()}


def unlike_repetitions(runs: Sequence[Track], lever_m: float) -> list[str]:
    """One line for each group of repetitions of which one ends elsewhere than its wheels and the others say.

    Wheel parameters, right or wrong, give repetitions of a motion the same error. Its deviation from their
    median counts from 10 mm per metre of the path on, and from six times the median deviation of all on.
    Of two repetitions nothing tells which one is wrong.

    Args:
        runs: odometry of the recordings.
        lever_m: distance of the wheels from the middle, at which turns count.
    """
    groups = [group for group in _alike([run.recording for run in runs]) if len(group) > 1]
    errors = [_error_by_metre(run, lever_m) for run in runs]
    off = {
        k: float(np.linalg.norm(errors[k] - np.median([errors[i] for i in group], axis=0)))
        for group in groups
        for k in group
    }
    usual = float(np.median(list(off.values()))) if off else np.inf
    out = []
    for group in groups:
        far = [k for k in group if off[k] > max(_UNLIKE, _TIMES_USUAL * usual)]
        if far:
            names = ", ".join(runs[k].recording.name for k in (far if len(group) > 2 else group))
            out.append(
                f"{names}: repetitions that do not agree, by {1e3 * max(off[k] for k in far):.0f} mm per "
                f"metre between wheels and ground truth (typical: {1e3 * usual:.1f}): a fault that no check "
                "names, or slip; record the motion again, or leave out the one that is wrong"
            )
    return out


def _error_by_metre(run: Track, lever_m: float) -> Array:
    """Last error (3,) in the frame of the first pose, with turns at the wheels, per metre of the path."""
    along = np.abs(np.diff(run.truth[::_ROWS], axis=0))
    way_m = float(np.hypot(along[:, 0], along[:, 1]).sum() + lever_m * along[:, 2].sum())
    ahead = _in_first_frame(run.truth, run.error[-1, :2])
    return np.array([*ahead, lever_m * run.error[-1, 2]]) / max(way_m, _NEAR_START_M)


def _alike(recordings: Sequence[Recording]) -> list[list[int]]:
    """Indices of recordings of one motion with similar end points, by group."""
    ends, groups = [_end_m(r.truth_pose) for r in recordings], list[list[int]]()
    for k, one in enumerate(recordings):
        for group in groups:
            if recordings[group[0]].motion == one.motion and _go_alike(ends[k], ends[group[0]]):
                group.append(k)
                break
        else:
            groups.append([k])
    return groups


def _end_m(pose: Array) -> Array:
    """Last position (2,) of poses (n, 3), in the frame of the first one."""
    return _in_first_frame(pose, pose[-1, :2] - pose[0, :2])


def _in_first_frame(pose: Array, vector: Array) -> Array:
    """A vector (2,) in the frame of the first of poses (n, 3)."""
    c, s = np.cos(pose[0, 2]), np.sin(pose[0, 2])
    x, y = vector
    return np.array([c * x + s * y, c * y - s * x])


def _go_alike(end: Array, other: Array) -> bool:
    """Whether two end points (2,), m, are nearer to each other than to the start, or both near the start."""
    apart_m = float(np.hypot(*(end - other)))
    return apart_m < max(_NEAR_START_M, 0.5 * float(max(np.hypot(*end), np.hypot(*other))))


def _spread(ways: Sequence[Sequence[Array]]) -> float:
    """Standard deviation of end points (2,), m, about the mean of their group; NaN without a group of two."""
    free = sum(len(ends) - 1 for ends in ways)
    if not free:
        return float("nan")
    off = np.concatenate([np.array(ends) - np.mean(ends, axis=0) for ends in ways])
    return float(np.sqrt(np.sum(np.sum(off**2, axis=0) / free)))


def table_of(runs: Sequence[Track]) -> Table:
    """Errors by motion, and their mean over motions."""
    motions: dict[str, list[Track]] = {}
    for run in runs:
        motions.setdefault(run.recording.motion, []).append(run)
    errors = {m: metrics(own) for m, own in motions.items()}
    table = {m: {k: found[k] for k in _KEYS} for m, found in errors.items()}
    if table:
        table["mean"] = {k: float(np.mean([row[k] for row in table.values()])) for k in _KEYS}
    return table
