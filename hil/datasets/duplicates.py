"""Recognises copies of a recording, under other file names and in other formats."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.core.geometry import Array
from hil.datasets.sampling import interpolate
from hil.datasets.wheel_log import Recording

_ALIKE_S, _ALIKE_RAD = 1e-5, 1e-6
_ALIKE_TRUTH = 1e-3


def without_copies(recordings: Sequence[Recording]) -> list[Recording]:
    """Drop copies: keep the first recording of each set, in order; a repair names the others."""
    out: list[Recording] = []
    for one in recordings:
        twin = next((k for k, other in enumerate(out) if is_copy(one, other)), None)
        if twin is None:
            out.append(one)
            continue
        more = {f"copy of it left out, {one.sources[0] if one.sources else one.name}": 1}
        out[twin] = replace(out[twin], repairs={**out[twin].repairs, **more})
    return out


def is_copy(one: Recording, other: Recording) -> bool:
    """Whether two recordings are of one drive: same wheel rows, and ground truth within 1 mm and 1 mrad.

    Line ends, compression, digits of an export and names do not matter. An export contains the ground truth
    at the instants of the wheels. Its rows lie on the line between the rows of its source, but the source's
    rows are off the line between the export's rows by their noise. So agreement in one direction is enough.
    """
    if len(one.t_s) != len(other.t_s):
        return False
    begin_s, begin_other_s = one.t_s[0], other.t_s[0]
    if not (
        _alike(one.wheel_angle_rad, other.wheel_angle_rad, _ALIKE_RAD)
        and _alike(one.steering_rad, other.steering_rad, _ALIKE_RAD)
        and _alike(one.t_s - begin_s, other.t_s - begin_other_s, _ALIKE_S)
    ):
        return False
    at_s, there_s = one.truth_t_s - begin_s, other.truth_t_s - begin_other_s
    return _on_line(at_s, one.truth_pose, there_s, other.truth_pose) or _on_line(
        there_s, other.truth_pose, at_s, one.truth_pose
    )


def wheel_fingerprint(recording: Recording) -> list[float]:
    """Fingerprint: number of wheel rows, duration (s), mean turns and mean steering angles (rad).

    Copies have the same, whatever their files. Two measured drives do not.
    """
    turned = recording.wheel_angle_rad - recording.wheel_angle_rad[0]
    means = np.concatenate([turned.mean(axis=0), recording.steering_rad.mean(axis=0)])
    return [float(len(recording.t_s)), float(recording.t_s[-1] - recording.t_s[0]), *means.tolist()]


def same_wheels(one: Sequence[float], other: Sequence[float]) -> bool:
    """Whether two fingerprints of `wheel_fingerprint` are of one drive."""
    if len(one) != len(other) or one[0] != other[0] or not abs(one[1] - other[1]) < _ALIKE_S:
        return False
    return _alike(np.array(one[2:]), np.array(other[2:]), _ALIKE_RAD)


def _on_line(at_s: Array, pose: Array, line_s: Array, line: Array) -> bool:
    """Whether poses (n, 3) at times (n,) lie on the polyline of others, (m, 3) at (m,), where both exist."""
    both = (at_s >= line_s[0]) & (at_s <= line_s[-1])
    return _alike(pose[both], interpolate(at_s[both], line_s, line), _ALIKE_TRUTH)


def _alike(one: Array, other: Array, within: float) -> bool:
    return bool(np.all(np.abs(one - other) < within))
