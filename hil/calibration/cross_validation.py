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
    alike: dict[str, list[list[Array]]] = {}
    for r in recordings:
        c, s = np.cos(r.truth_pose[0, 2]), np.sin(r.truth_pose[0, 2])
        moved = r.truth_pose[-1, :2] - r.truth_pose[0, :2]
        end = np.array([c * moved[0] + s * moved[1], -s * moved[0] + c * moved[1]])
        ways = alike.setdefault(r.motion, [])
        same = next((ends for ends in ways if _go_alike(end, ends[0])), None)
        if same is None:
            ways.append([end])
        else:
            same.append(end)
    return {motion: _spread(ways) for motion, ways in alike.items()}


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
