"""Fits how the ground truth of a recording relates to its wheels: clock, heading and centre of its body.

Both measured the same drive. Their moves over 0.2 s differ by what one linear model explains: stamps that are
late or run fast, a heading that is not the robot's, a tracked point that is not the middle of the wheels.
Starts, stops and turns tell these apart from each other and from wrong radii, which scale all moves. The
delay that the fit starts from is the maximum of the cross-correlation of both speeds.
"""

from dataclasses import dataclass
from typing import TypeAlias, cast

import numpy as np
import numpy.typing as npt

from hil.core.geometry import Array, Bools
from hil.datasets.nominal_robot import lever_m
from hil.datasets.sampling import LONGEST_GAP_S, interpolate, is_slow, wheel_steps
from hil.datasets.wheel_log import Recording
from hil.robot.kinematics import twist_of_vectors, wheel_vectors
from hil.robot.odometry import integrate

_GRID_S, _WINDOW_S = 0.02, 0.2
_BEND_S = 0.2
"""Step of the second derivative by the delay, s."""
_ALIKE, _MOST_FAST = 0.9, 0.06
_GAPS_LONGER = 1.5
_ROUNDS, _UNEXPLAINED, _OVERLAP, _STDS = 5, 0.2, 3.0, 5.0
_LEAST, _REPLACED = 1e-12, 1e4
_REST_S, _RESTS_RAD = 0.3, 0.02

Moves: TypeAlias = tuple[npt.NDArray[np.complex128], Array]
"""Translations x + iy, m, in the frame at the begin of each move, and turns, rad."""


@dataclass(frozen=True)
class TruthFit:
    """Relation of a ground truth to the wheels of nominal odometry, with standard errors.

    Attributes:
        late_s: delay of the ground truth in the middle of the recording.
        fast: share by which the clock of the ground truth runs fast.
        fast_std: standard error of `fast`.
        heading_rad: heading of the ground truth minus that of the direction in which the wheels roll.
        heading_std_rad: standard error of `heading_rad`.
        centre_m: tracked point (x + iy) in the frame of the body of the ground truth.
        centre_std_m: standard error of its two coordinates, the larger one.
        scale: distance by ground truth over distance by wheels.
        scale_std: standard error of `scale`.
        drift_rad_s: rate at which the heading of the ground truth drifts from that of the wheels.
        drift_std_rad_s: standard error of `drift_rad_s`.
        skew: share by which the axes of the ground truth differ in scale (real part) or are sheared
            (imaginary part), both halved.
        skew_std: standard error of its two parts, the larger one.
        wobble_s: largest delay that is no stretch of the clock, about the middle of the recording.
        wobble_std_s: standard error of `wobble_s`.
        smooth_s2: variance, s^2, of the times over which the ground truth averages the motion of the wheels.
        smooth_std_s2: standard error of `smooth_s2`.
    """

    late_s: float
    fast: float
    fast_std: float
    heading_rad: float
    heading_std_rad: float
    centre_m: complex
    centre_std_m: float
    scale: float
    scale_std: float
    drift_rad_s: float
    drift_std_rad_s: float
    skew: complex
    skew_std: float
    wobble_s: float
    wobble_std_s: float
    smooth_s2: float
    smooth_std_s2: float


def truth_fit(recording: Recording) -> TruthFit | None:
    """Fit of a recording, computed once and cached; None where wheels and ground truth move unlike."""
    if "truth_fit" not in recording.derived:
        recording.derived["truth_fit"] = _found(recording)
    return cast("TruthFit | None", recording.derived["truth_fit"])


def _found(recording: Recording) -> TruthFit | None:
    at_s, pose = recording.truth_t_s, recording.truth_pose
    by_wheels, lever = _by_wheels(recording), lever_m(recording.nominal.geometry)
    begun, middle_s = _clock(recording, by_wheels), 0.5 * float(at_s[0] + at_s[-1])
    if begun is None:
        return None
    late_s, fast = begun
    begin_s, end_s, (way, turn) = _true_moves(at_s, pose)
    if len(begin_s) == 0:
        return None

    first_s, last_s = _known_from_to(recording)

    def rolled(late_s: float) -> tuple[npt.NDArray[np.complex128], Array, Bools]:
        begin, end = (t - late_s - fast * (t - middle_s) for t in (begin_s, end_s))
        u, v = _moves(*(interpolate(t, recording.t_s, by_wheels) for t in (begin, end)))
        return u, v, (begin >= first_s) & (end <= last_s)

    turned = 1.0 + 0.0j, 1.0
    carried = np.exp(1j * turn) - 1.0
    for _ in range(_ROUNDS):
        (u, v, seen), (u1, v1, _), (u0, v0, _) = (rolled(late_s + step) for step in (0.0, _GRID_S, -_GRID_S))
        du, dv = turned[0] * (u1 - u0) / (2.0 * _GRID_S), turned[1] * (v1 - v0) / (2.0 * _GRID_S)
        since, none = begin_s - middle_s, np.zeros(len(v))
        translation = np.stack([du, du * since, u, 1j * u, none, carried, 1j * carried], axis=1)
        turning = lever * np.stack([dv, dv * since, none, none, v, none, none], axis=1)
        rows = np.concatenate([translation.real, translation.imag, turning]) * np.tile(seen, 3)[:, None]
        wanted = np.concatenate([way.real, way.imag, lever * turn]) * np.tile(seen, 3)
        size = np.maximum(np.linalg.norm(rows, axis=0), _LEAST)
        x = np.linalg.lstsq(rows / size, wanted, rcond=1e-6)[0] / size
        late_s, fast, turned = late_s + float(x[0]), fast + float(x[1]), (complex(x[2], x[3]), float(x[4]))
    left = wanted - rows @ x
    if np.linalg.norm(left) > _UNEXPLAINED * np.linalg.norm(wanted):
        return None
    overlap = max(1.0, _WINDOW_S / float(np.median(np.diff(begin_s, append=end_s[-1]))))
    std = _errors(rows, left, overlap)
    if turned[1] < -_STDS * std[4]:
        return None
    heading, share = np.interp(begin_s, at_s, pose[:, 2]), 2.0 * since / float(at_s[-1] - at_s[0])
    translation, turning = _unlike_rows(turned[0] * u, (du, dv), heading, (since, share), end_s - begin_s)
    more_rows = np.concatenate([translation.real, translation.imag, lever * turning])
    more_rows *= np.tile(seen, 3)[:, None]
    every = np.hstack([more_rows, rows])
    size = np.maximum(np.linalg.norm(every, axis=0), _LEAST)
    more = np.linalg.lstsq(every / size, wanted, rcond=1e-6)[0] / size
    more_std = _errors(every, wanted - every @ more, overlap)
    (u1, v1, _), (u0, v0, _) = (rolled(late_s + step) for step in (_BEND_S, -_BEND_S))
    bent = [turned[0] * (u1 - 2.0 * u + u0), turned[1] * lever * (v1 - 2.0 * v + v0)]
    averaged = _averaged(np.concatenate([bent[0].real, bent[0].imag, bent[1]]) * np.tile(seen, 3), rows, left)
    return TruthFit(
        late_s,
        fast,
        float(std[1]),
        -float(np.angle(turned[0])),
        float(std[3] / max(abs(turned[0]), _LEAST)),
        complex(x[5], x[6]),
        float(max(std[5:7])),
        abs(turned[0]),
        float(std[2]),
        float(more[0]),
        float(more_std[0]),
        complex(more[1], more[2]),
        float(max(more_std[1:3])),
        float(np.hypot(*more[3:5])),
        float(max(more_std[3:5])),
        averaged[0],
        averaged[1] * overlap**0.5,
    )


def _averaged(bent: Array, rows: Array, left: Array) -> tuple[float, float]:
    """Variance, s^2, of the times over which a motion is averaged, and its standard error.

    An average is later and earlier by turns: it adds half the variance times the second derivative.

    Args:
        bent: (n,) second differences of the motion over `_BEND_S`.
        rows: (n, k) derivatives that the fit has used.
        left: (n,) what it has left.
    """
    every = np.hstack([2.0 / _BEND_S**2 * 0.25 * bent[:, None], rows])
    size = np.maximum(np.linalg.norm(every, axis=0), _LEAST)
    found = np.linalg.lstsq(every / size, left, rcond=1e-6)[0] / size
    return float(found[0]), float(_errors(every, left - every @ found, 1.0)[0])


def _unlike_rows(
    u: npt.NDArray[np.complex128], speeds: Moves, heading: Array, at: tuple[Array, Array], lasts_s: Array
) -> tuple[npt.NDArray[np.complex128], Array]:
    """Translations and turns (n, 7): drift, skew (2), bends of the clock (2), turns by slip (2).

    Args:
        u: (n,) translations as the wheels say, in the frame of the body.
        speeds: (n,) derivatives of translations and turns by the delay.
        heading: (n,) heading of the ground truth at the begin of the moves, rad.
        at: (n,) times from the middle of the recording, s, and the same as shares of its half.
        lasts_s: (n,) lengths of the moves, s.
    """
    (du, dv), (since, share), none = speeds, at, np.zeros(len(u))
    bends = (1.5 * share**2 - 0.5, 2.5 * share**3 - 1.5 * share)
    skewed = np.conj(u * np.exp(2j * heading))
    translations = [-1j * since * u, skewed, 1j * skewed, *(du * bend for bend in bends), none, none]
    turns = [lasts_s, none, none, *(dv * bend for bend in bends), u.real, u.imag]
    return np.stack(translations, axis=1), np.stack(turns, axis=1)


def _errors(rows: Array, left: Array, overlap: float) -> Array:
    """Standard errors (k,) of the coefficients of rows (n, k) that leave (n,), where moves overlap.

    A coefficient that the others can replace, as a skew of the axes on a straight line, has an infinite one.
    """
    size = np.maximum(np.linalg.norm(rows, axis=0), _LEAST)
    information = (rows / size).T @ (rows / size) + 1e-9 * np.eye(len(size))
    spread = _OVERLAP * overlap * float(np.mean(left**2))
    inflation = np.diag(np.linalg.inv(information))
    std = np.sqrt(spread * inflation) / size
    return np.where(inflation > _REPLACED, np.inf, std)


def _known_from_to(recording: Recording) -> tuple[float, float]:
    """Span, s, in which the wheels' motion is known: beyond their rows only where they rest there."""
    t_s, angle = recording.t_s, recording.wheel_angle_rad
    rests = [
        float(np.ptp(angle[rows], axis=0).max(initial=0.0)) < _RESTS_RAD
        for rows in (t_s < t_s[0] + _REST_S, t_s > t_s[-1] - _REST_S)
    ]
    return (-np.inf if rests[0] else float(t_s[0])), (np.inf if rests[1] else float(t_s[-1]))


def _true_moves(at_s: Array, pose: Array) -> tuple[Array, Array, Moves]:
    """Begin and end (k,), s, of moves of ground truth (n, 3), and the moves; row by row where it is slow."""
    if is_slow(at_s):
        lasts_s = np.diff(at_s)
        whole = lasts_s <= _GAPS_LONGER * float(np.median(lasts_s))
        return at_s[:-1][whole], at_s[1:][whole], _moves(pose[:-1][whole], pose[1:][whole])
    grid_s, n = np.arange(at_s[0], at_s[-1], _GRID_S), round(_WINDOW_S / _GRID_S)
    poses, known = interpolate(grid_s, at_s, pose), _known(grid_s, at_s)
    both = known[n:] & known[:-n]
    return grid_s[:-n][both], grid_s[n:][both], _moves(poses[:-n][both], poses[n:][both])


def _moves(begin: Array, end: Array) -> Moves:
    x, y, turn = (end - begin).T
    return (x + 1j * y) * np.exp(-1j * begin[:, 2]), turn


def _clock(recording: Recording, by_wheels: Array) -> tuple[float, float] | None:
    """Delay, s, and stretch of the ground truth by the cross-correlation of speeds; None where these differ.

    Stretches are tried in steps of a fifth of a second over the whole recording.
    """
    at_s, pose = recording.truth_t_s, recording.truth_pose
    grid_s = np.arange(at_s[0], at_s[-1], _GRID_S)
    n = round(_WINDOW_S / _GRID_S)
    lever, known = lever_m(recording.nominal.geometry), _known(grid_s, at_s)
    truth, wheels = (
        _lengths(interpolate(grid_s, *rows), n, lever) * (known[n:] & known[:-n])
        for rows in ((at_s, pose), (recording.t_s, by_wheels))
    )
    count, since_s = 2 * len(truth), grid_s[n:] - grid_s[n:].mean()
    by_frequency = np.fft.rfft(wheels[::-1], count) / max(float(np.linalg.norm(wheels)), _LEAST)
    step = _WINDOW_S / float(at_s[-1] - at_s[0])
    alike, late_s, fast = 0.0, 0.0, 0.0
    for stretch in np.arange(-round(_MOST_FAST / step), round(_MOST_FAST / step) + 1) * step:
        other = np.interp(since_s * (1.0 + stretch), since_s, truth)
        other /= max(float(np.linalg.norm(other)), _LEAST)
        overlap = np.fft.irfft(np.fft.rfft(other, count) * by_frequency, count)[:-1]
        best = int(np.argmax(overlap))
        if overlap[best] > alike and 0 < best < len(overlap) - 1:
            alike, late_s, fast = float(overlap[best]), (best - len(wheels) + 1) * _GRID_S, float(stretch)
    return (late_s, fast) if alike >= _ALIKE else None


def _lengths(poses: Array, n: int, lever: float) -> Array:
    """Lengths (k - n,), m, of moves over n of poses (k, 3), with turns at the distance `lever`."""
    x, y, turn = (poses[n:] - poses[:-n]).T
    return np.asarray(np.hypot(x, y) + lever * np.abs(turn), dtype=np.float64)


def _by_wheels(recording: Recording) -> Array:
    """Poses (n, 3) at the wheel rows by nominal odometry, started at zero."""
    wheels = recording.nominal.geometry
    rotation, steering = wheel_steps(recording, recording.t_s, "position")
    vectors = wheel_vectors(rotation * wheels.radius_m, steering - wheels.steering_zero_rad)
    return integrate(np.zeros(3), twist_of_vectors(wheels, vectors, "exact"))


def _known(grid_s: Array, at_s: Array) -> Bools:
    """Mask of instants (k,) at which the ground truth, rows (m,), has no gap."""
    lasts_s = np.diff(at_s)
    longest_s = max(LONGEST_GAP_S, _GAPS_LONGER * float(np.median(lasts_s)))
    behind = np.clip(np.searchsorted(at_s, grid_s), 1, len(at_s) - 1)
    return np.asarray(lasts_s[behind - 1] <= longest_s, dtype=np.bool_)
