"""Finds corrupt recordings: those that contradict themselves, or contradict all others.

Each recording is first checked by itself: jumps of the ground truth, wheels that do not move as those of one
body, wrong signs. Then it is compared with the others by the residual of a robust fit. An effect
that at least half of the recordings show belongs to the robot, its bench file or the order of columns; no
recording is left out for it. Only a jump of the ground truth, or one that was computed from the wheels, is
corrupt however many recordings have one.
"""

from collections.abc import Sequence

import numpy as np

from hil.calibration.fitting import fit
from hil.calibration.problem import RECOMMENDED
from hil.core.geometry import Array, Bools
from hil.datasets.fit_blocks import reduce_recordings
from hil.datasets.nominal_robot import Nominal, lever_m
from hil.datasets.odd_wheels import odd_wheels
from hil.datasets.truth_of_wheels import of_wheels
from hil.datasets.wheel_log import Recording
from hil.datasets.wrong_signs import (
    NO_MOTION,
    RATES_AGAINST,
    is_at_rest,
    missed_shares,
    rates_against_angles,
    wrong_signs,
)

Reasons = dict[int, str]
"""Reason why a recording is corrupt, by its index."""

_STRIDE_S, _ROLLING = 0.5, 0.3
_APART, _APART_WAY = 0.15, 0.1
_TOGETHER = 0.08
_WHEELS = ("front left", "back left", "back right", "front right")
_FEWEST = 3
_TIMES_TYPICAL, _LEAST_MISFIT, _MISSED_TOO = 8.0, 12.0, 0.06
_TIMES_FAR, _FAR_MISFIT = 25.0, 50.0
"""Misfits are in residual scales of a fit (4 mm, 6 mrad): 12 is 28 mm all along the drive, 50 is 115 mm."""


def corrupt(recordings: Sequence[Recording], nominal: Nominal) -> dict[str, str]:
    """Reasons why recordings are corrupt, by name; recordings without a reason are good.

    Args:
        recordings: runs of one robot.
        nominal: nominal robot.
    """
    found: Reasons = {k: one.contradictions[0] for k, one in enumerate(recordings) if one.contradictions}
    found |= {k: why for k, one in enumerate(recordings) if k not in found and (why := of_wheels(one))}
    for look in (_at_rest, _wrong_signs, _apart, _misfits):
        left = [k for k in range(len(recordings)) if k not in found]
        reported = look([recordings[k] for k in left], nominal) if left else {}
        if len(reported) < len(left):
            found |= {left[k]: why for k, why in reported.items()}
    return {recordings[k].name: found[k] for k in sorted(found)}


def _at_rest(recordings: Sequence[Recording], nominal: Nominal) -> Reasons:
    """Recordings in which no wheel turns."""
    return {k: NO_MOTION for k, one in enumerate(recordings) if is_at_rest(one.wheel_angle_rad)}


def _wrong_signs(recordings: Sequence[Recording], nominal: Nominal) -> Reasons:
    """Find columns with the opposite sign, where only a minority of the recordings has them."""
    out = {k: RATES_AGAINST for k, one in enumerate(recordings) if rates_against_angles(one)}
    found = wrong_signs(recordings, nominal)
    if not found.of_all:
        out |= {k: why for k in range(len(recordings)) if (why := found.warning_for(k))}
    return out if 2 * len(out) < len(recordings) else {}


def _apart(recordings: Sequence[Recording], nominal: Nominal) -> Reasons:
    """Find wheels that do not move as those of one rigid body, whatever the slip.

    With a stuck wheel 0.35 or more of the way contradicts, with exchanged wheels 0.25 or more; with
    tolerances and wrong steering zeros of some degrees up to 0.06.
    """
    vectors = _strides(recordings, nominal)
    share = np.array([_apart_share(u, nominal) for u in vectors])
    wrong = share > _APART_WAY
    if not wrong.any() or _as_many_alike(wrong, _turning(recordings, nominal)):
        return {}
    out = {}
    for k in np.flatnonzero(wrong).tolist():
        odd = odd_wheels([recordings[k]], nominal.geometry)
        out[k] = "; ".join(odd) if odd else _which_wheel(vectors[k], share[k], nominal)
    return out


def _strides(recordings: Sequence[Recording], nominal: Nominal) -> list[Array]:
    """Wheel displacements (s, 8), m, of each recording in the 0.5 s strides in which the wheels roll."""
    blocks, out = reduce_recordings(recordings, _STRIDE_S), []
    for k, count in enumerate(blocks.counts):
        u = blocks.wheel_rad[k, :count] * np.repeat(nominal.geometry.radius_m, 2)
        size = np.linalg.norm(u, axis=1)
        out.append(u[size > _ROLLING * size.mean()])
    return out


def _apart_share(u: Array, nominal: Nominal, without: int | None = None) -> float:
    """Share of the way in which wheel displacements (s, 8) clearly fit no rigid-body motion.

    `without` leaves one wheel out and applies the stricter limit `_TOGETHER` to the others.
    """
    kept = [i for i in range(8) if without is None or i // 2 != without]
    p = nominal.geometry.projection()[kept]
    size = np.linalg.norm(u, axis=1)
    apart = np.linalg.norm(u[:, kept] - u[:, kept] @ np.linalg.pinv(p).T @ p.T, axis=1)
    limit = _APART if without is None else _TOGETHER
    return float(size[apart > limit * size].sum() / max(size.sum(), 1e-9))


def _which_wheel(u: Array, share: float, nominal: Nominal) -> str:
    """Description of the fault of wheels (s, 8) that contradict each other in `share` of the way."""
    alone = [i for i in range(4) if _apart_share(u, nominal, without=i) < _APART_WAY]
    where = f"in {100 * share:.0f} % of the way"
    if len(alone) == 1:
        i = alone[0]
        name = f"{_WHEELS[i]} wheel (phi{i + 1}, delta{i + 1})"
        return f"its {name} contradicts the other three {where}"
    return f"its wheels contradict each other {where}, as those of no rigid body do"


def _turning(recordings: Sequence[Recording], nominal: Nominal) -> Array:
    """Share (R,) of turning in each recording's way by ground truth: lines do not tell wheels apart."""
    out = []
    for one in recordings:
        seconds = np.floor(one.truth_t_s - one.truth_t_s[0])
        ends = np.append(np.flatnonzero(np.diff(seconds, prepend=-1.0)), len(seconds) - 1)
        x, y, theta = np.abs(np.diff(one.truth_pose[ends], axis=0)).T
        turned_m = lever_m(nominal.geometry) * float(theta.sum())
        out.append(turned_m / max(turned_m + float(np.hypot(x, y).sum()), 1e-9))
    return np.array(out)


def _as_many_alike(wrong: Bools, turning: Array) -> bool:
    """Whether at least two, and at least half, of the recordings that could show the fault have it."""
    right = ~wrong & (turning >= 0.5 * turning[wrong].min())
    return int(wrong.sum()) >= max(2, int(right.sum()))


def _misfits(recordings: Sequence[Recording], nominal: Nominal) -> Reasons:
    """Find recordings that a robust fit misses by more than slip explains.

    A motion that the fit misses in every recording does not count. A burst of slip may turn a robot so that
    the rest of its way is off by 15 times the typical error and 35 mm; from second to second the wheels still
    agree with the ground truth, but for 0.05 of the way.
    """
    if len(recordings) < _FEWEST:
        return {}
    blocks = reduce_recordings(recordings, RECOMMENDED.block_s)
    found = fit(blocks, RECOMMENDED, nominal.geometry)
    misfit = np.sqrt(found.problem.recording_costs(found.solution.z))
    typical = float(np.median(misfit))
    wrong = misfit > max(_TIMES_TYPICAL * typical, _LEAST_MISFIT)
    wrong &= missed_shares(recordings, found.geometry) > _MISSED_TOO
    wrong |= misfit > max(_TIMES_FAR * typical, _FAR_MISFIT)
    motions = np.array(blocks.motions)
    for motion in set(motions[wrong]):
        own = motions == motion
        if own.sum() > 1 and wrong[own].all():
            wrong[own] = False
    if 2 * np.count_nonzero(wrong) >= len(recordings):
        return {}
    times = misfit / typical
    return {
        int(k): f"it does not fit the others: {times[k]:.0f} times the error of the typical recording"
        for k in np.flatnonzero(wrong)
    }
