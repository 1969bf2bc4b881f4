"""Fits how the ground truth of a recording relates to its wheels: clock, heading and centre of its body.

Both measured the same drive. Their moves over 0.2 s differ by what one linear model explains: stamps that are
late or run fast, a heading that is not the robot's, a tracked point that is not the middle of the wheels.
Starts, stops and turns tell these apart from each other and from wrong radii, which scale all moves. The
delay that the fit starts from is the maximum of the cross-correlation of both speeds. Moves in which the
robot slips count less (Huber's weights). What the model leaves is then compared with each further cause.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np

from hil.core.geometry import Array, Bools
from hil.datasets.nominal_robot import lever_m
from hil.datasets.sampling import interpolate
from hil.datasets.truth_moves import GRID_S, WINDOW_S, Drive, known_at
from hil.datasets.wheel_log import Recording

_ALIKE, _MOST_FAST = 0.9, 0.06
_PAUSE_S = 30.0
"""Time without a wheel row up to which it is a pause, and beyond which the clock has leapt."""
_ROUNDS, _UNEXPLAINED, _OVERLAP, _STDS = 6, 0.2, 3.0, 5.0
_LEAST, _REPLACED = 1e-12, 1e4
_USUAL, _CENTRE_M, _POINT = 2.0, 0.1, 5


@dataclass(frozen=True)
class Cause:
    """A further cause of the difference of ground truth and wheels.

    Attributes:
        values: coefficients, of which each cause has one or two (`hil.datasets.truth_moves`).
        std: standard error of the coefficients, the largest one.
        gain: logarithm of the likelihood ratio of the fit with it and without it.
    """

    values: Array
    std: float
    gain: float

    @property
    def size(self) -> float:
        """Size of the coefficients together."""
        return float(np.linalg.norm(self.values))


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
        direction: complex values a, b, c: with a known tracked point x + iy the ground truth moves in the
            direction a + b x + c y beside that of the wheels.
        direction_std_rad: standard error of that direction.
        turns_rad_s: mean rate at which the ground truth turns along a path; 0 where it turns on the spot.
        heading_beyond_path: share of its turns by which the heading turns further than the path.
        causes: further causes by name, see `hil.datasets.truth_moves.Drive.causes`.
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
    direction: tuple[complex, complex, complex]
    direction_std_rad: float
    turns_rad_s: float
    heading_beyond_path: float
    causes: Mapping[str, Cause]

    @property
    def scale_of_middle(self) -> float:
        """Distance by ground truth over distance by wheels, if the middle of the wheels were tracked."""
        return abs(self.direction[0])

    def heading_with(self, centre_m: complex) -> float:
        """Heading of the ground truth minus the direction of the wheels, rad, with a known tracked point."""
        at, by_x, by_y = self.direction
        return -float(np.angle(at + by_x * centre_m.real + by_y * centre_m.imag))


def truth_fit(recording: Recording) -> TruthFit | None:
    """Fit of a recording, computed once and cached; None where wheels and ground truth move unlike."""
    if "truth_fit" not in recording.derived:
        recording.derived["truth_fit"] = _found(recording)
    return cast("TruthFit | None", recording.derived["truth_fit"])


def _found(recording: Recording) -> TruthFit | None:
    drive = Drive.of(recording)
    begun = None if drive is None else _clock(recording, drive.by_wheels)
    if drive is None or begun is None:
        return None
    (late_s, fast), turned, weights, error_m = begun, (1.0 + 0.0j, 1.0), np.ones(len(drive.begin_s)), _LEAST
    for _ in range(_ROUNDS):
        rows, seen, rolls = drive.relation(late_s, fast, turned)
        kept = np.tile(np.sqrt(weights) * seen, 3)
        x = _solved(*_with_prior(rows * kept[:, None], drive.wanted * kept, error_m * drive.overlap**0.5))
        late_s, fast, turned = late_s + float(x[0]), fast + float(x[1]), (complex(x[2], x[3]), float(x[4]))
        error_m, weights = _weights(drive.wanted - rows @ x, seen & rolls)
    left, wanted = (values * np.tile(seen, 3) for values in (drive.wanted - rows @ x, drive.wanted))
    if np.linalg.norm(left) > _UNEXPLAINED * np.linalg.norm(wanted):
        return None
    rows, wanted = _with_prior(rows * kept[:, None], wanted * kept, error_m * drive.overlap**0.5)
    std = _errors(rows, wanted - rows @ x, drive.overlap)
    if turned[1] < -_STDS * std[4]:
        return None
    slip, changes, steady = drive.causes(late_s, fast, turned)
    slip, changes, steady = (
        _like(slip, kept),
        *({n: _like(c, kept) for n, c in more.items()} for more in (changes, steady)),
    )
    base = np.hstack([rows, slip])
    causes = {name: _added(c, base, wanted, drive.overlap) for name, c in changes.items()}
    likely = changes[max(causes, key=lambda name: causes[name].gain)]
    for name, columns in steady.items():
        other = [c for more, c in steady.items() if more != name]
        causes[name] = _added(columns, np.hstack([base, likely, *other]), wanted, drive.overlap)
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
        *_direction(rows, wanted, drive.overlap),
        drive.turns_rad_s,
        drive.heading_beyond_path(late_s, fast),
        causes,
    )


def _direction(rows: Array, wanted: Array, overlap: float) -> tuple[tuple[complex, complex, complex], float]:
    """`TruthFit.direction` and its standard error, of rows (n, 7), of which the last two are the prior."""
    own, points = rows[:-2, :_POINT], rows[:-2, _POINT:]
    at, by = _solved(own, wanted[:-2]), [-_solved(own, column) for column in points.T]
    left = wanted[:-2] - own @ at
    std = float(_errors(own, left, overlap)[3]) / max(float(np.hypot(at[2], at[3])), _LEAST)
    return (complex(at[2], at[3]), complex(by[0][2], by[0][3]), complex(by[1][2], by[1][3])), std


def _added(columns: Array, base: Array, wanted: Array, overlap: float) -> Cause:
    """A cause of columns (n, k), added to a fit with rows (n, m)."""
    rows = np.hstack([columns, base])
    x = _solved(rows, wanted)
    left, before = wanted - rows @ x, wanted - base @ _solved(base, wanted)
    ratio = float(before @ before) / max(float(left @ left), _LEAST**2)
    k = columns.shape[1]
    std = float(max(_errors(rows, left, overlap)[:k]))
    return Cause(x[:k], std, 0.5 * np.count_nonzero(wanted) / overlap * float(np.log(max(ratio, 1.0))))


def _solved(rows: Array, wanted: Array) -> Array:
    """Coefficients (k,) of rows (n, k) by least squares."""
    size = np.maximum(np.linalg.norm(rows, axis=0), _LEAST)
    return np.asarray(np.linalg.lstsq(rows / size, wanted, rcond=1e-6)[0] / size, dtype=np.float64)


def _weights(left: Array, rolling: Bools) -> tuple[float, Array]:
    """Error, m, and weights (n,) of moves that leave (3 n,), by Huber: slip bends few."""
    size = np.linalg.norm(left.reshape(3, -1), axis=0)
    usual = float(np.median(size[rolling])) if rolling.any() else np.inf
    error_m = float(np.sqrt(np.mean(size[rolling] ** 2))) if rolling.any() else 0.0
    return error_m, np.asarray(np.minimum(1.0, _USUAL * usual / np.maximum(size, _LEAST)))


def _with_prior(rows: Array, wanted: Array, error_m: float) -> tuple[Array, Array]:
    """Rows (n + 2, 7) and moves: the tracked point is within about a decimetre of the middle of the wheels.

    On a line or a steady circle nothing else tells it from the heading and the distances.
    """
    prior = np.zeros((2, rows.shape[1]))
    prior[:, -2:] = error_m / _CENTRE_M * np.eye(2)
    return np.vstack([rows, prior]), np.append(wanted, np.zeros(2))


def _like(columns: Array, kept: Array) -> Array:
    """Columns (n + 2, k), weighted, beside rows with their prior."""
    return np.vstack([columns * kept[:, None], np.zeros((2, columns.shape[1]))])


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


def _clock(recording: Recording, by_wheels: Array) -> tuple[float, float] | None:
    """Delay, s, and stretch of the ground truth by the cross-correlation of speeds; None where these differ.

    Stretches are tried in steps of a fifth of a second over the whole recording. Where the clock of a
    recording leaps, the time of the leap is left out, and no stretch is tried.
    """
    steps_s = np.diff(recording.t_s)
    pauses = steps_s > _PAUSE_S
    left_out_s = np.concatenate(([0.0], np.cumsum(np.where(pauses, steps_s - _PAUSE_S, 0.0))))
    t_s = recording.t_s - left_out_s
    at_s = recording.truth_t_s - np.interp(recording.truth_t_s, recording.t_s, left_out_s)
    pose, most_fast = recording.truth_pose, 0.0 if pauses.any() else _MOST_FAST
    grid_s = np.arange(at_s[0], at_s[-1], GRID_S)
    n = round(WINDOW_S / GRID_S)
    lever, known = lever_m(recording.nominal.geometry), known_at(grid_s, at_s)
    truth, wheels = (
        _lengths(interpolate(grid_s, *rows), n, lever) * (known[n:] & known[:-n])
        for rows in ((at_s, pose), (t_s, by_wheels))
    )
    count, since_s = 2 * len(truth), grid_s[n:] - grid_s[n:].mean()
    by_frequency = np.fft.rfft(wheels[::-1], count) / max(float(np.linalg.norm(wheels)), _LEAST)
    step = WINDOW_S / float(at_s[-1] - at_s[0])
    alike, late_s, fast = 0.0, 0.0, 0.0
    for stretch in np.arange(-round(most_fast / step), round(most_fast / step) + 1) * step:
        other = np.interp(since_s * (1.0 + stretch), since_s, truth)
        other /= max(float(np.linalg.norm(other)), _LEAST)
        overlap = np.fft.irfft(np.fft.rfft(other, count) * by_frequency, count)[:-1]
        best = int(np.argmax(overlap))
        if overlap[best] > alike and 0 < best < len(overlap) - 1:
            alike, late_s, fast = float(overlap[best]), (best - len(wheels) + 1) * GRID_S, float(stretch)
    return (late_s, fast) if alike >= _ALIKE else None


def _lengths(poses: Array, n: int, lever: float) -> Array:
    """Lengths (k - n,), m, of moves over n of poses (k, 3), with turns at the distance `lever`."""
    x, y, turn = (poses[n:] - poses[:-n]).T
    return np.asarray(np.hypot(x, y) + lever * np.abs(turn), dtype=np.float64)
