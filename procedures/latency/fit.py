"""Fits the delay of a signal behind a command, from a motion with many small reversals.

All signals are compared as paths: commands and rates are integrated, so that a joint's angle, a turn rate
and a heading have the same shape, a rounded triangle, with the same lag of the motors. The response is
modelled as a dead time and a first-order lag; their sum is its mean delay (its first moment), which is
additive along a chain. Without the lag in the model, residuals would remain at the corners, and the fitted
delay would depend on which corners fall into gaps of a signal.

Two sensors of one steering axis are compared by their angles instead: backlash between them delays the second
one at every reversal, and does not affect the delay only while the axis is driven.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hil.core.clock import NS_PER_S
from hil.core.geometry import Array
from hil.loop.driven_motion import Motion

_BLOCKS = 8
_STUDENT_7 = 2.365
_EARLIEST_S, _LATEST_S = -0.15, 0.6
_LOWEST, _HIGHEST = (-0.2, 1e-4), (0.7, 0.3)
_LIKELY_LAG_S, _STEP_S = 0.02, 1e-5
_SECTIONS = ("read", "estimate", "control")
_DRIVEN_RAD_S = 0.3
_ROUNDS = 4


@dataclass(frozen=True)
class Delay:
    """Mean delay of a signal behind the command; `uncertainty_s` is half of the 95 % interval.

    Attributes:
        gain: amplitude of the signal over that of the command.
        misfit: RMS residual over the RMS of the signal; 1 for a signal that does not follow.
    """

    delay_s: float
    uncertainty_s: float
    gain: float
    misfit: float


_NOTHING = Delay(math.nan, math.nan, math.nan, math.nan)


class Command:
    """The commanded path: commands with their times, each held until the next.

    Args:
        t_s: (n,) times at which the commands were handed to the bus.
        value: (n,) commands, angles or rates; the path is their integral.
    """

    def __init__(self, t_s: Array, value: Array) -> None:
        self._t_s, self._value = t_s, value
        self._way = np.concatenate([[0.0], np.cumsum(value[:-1] * np.diff(t_s))])

    def path(self, t_s: Array) -> Array:
        """Return the commanded path at times `t_s`."""
        return np.asarray(np.interp(t_s, self._t_s, self._way), dtype=np.float64)

    def lagged(self, t_s: Array, lag_s: float) -> Array:
        """Return the path after a first-order lag, from rest: path minus lag times rate."""
        kept = np.exp(-np.diff(self._t_s) / lag_s).tolist()
        rate, rates = 0.0, [0.0]
        for value, share in zip(self._value[:-1].tolist(), kept, strict=True):
            rate = value + (rate - value) * share
            rates.append(rate)
        k = np.clip(np.searchsorted(self._t_s, t_s, side="right") - 1, 0, len(rates) - 1)
        since_s = np.maximum(t_s - self._t_s[k], 0.0)
        now = self._value[k] + (np.array(rates)[k] - self._value[k]) * np.exp(-since_s / lag_s)
        return self.path(t_s) - lag_s * now


def sent_s(motion: Motion) -> Array:
    """Return (n,) times at which the commands were handed to the bus, s since the first cycle began."""
    origin_ns = motion.records[0].inputs.t_ns
    return np.array(
        [
            (r.start_ns + sum(r.timing_ns.get(k, 0) for k in _SECTIONS) - origin_ns) / NS_PER_S
            for r in motion.records
        ]
    )


def fit_delay(command: Command, t_s: Array, path: Array) -> Delay:
    """Fit the delay of a path (n,) behind the command, together with offset and constant drift.

    NaN with too few samples. The interval comes from leaving out each eighth of the motion.
    """
    from scipy.optimize import least_squares  # takes 0.5 s to import, not needed to drive

    known = np.isfinite(path)
    t, y = t_s[known], path[known]
    if len(t) < 10 * _BLOCKS:
        return _NOTHING
    dead_s = _coarse(command, t, y) - _LIKELY_LAG_S

    def residuals(q: Array) -> Array:
        return _follow(command, t, y, float(q[0]), float(q[1]))[0]

    start = (dead_s, _LIKELY_LAG_S)
    found = least_squares(residuals, start, bounds=(_LOWEST, _HIGHEST), x_scale=(0.01, 0.01))
    dead_s, lag_s = map(float, found.x)
    residual, (gain, *_), design = _follow(command, t, y, dead_s, lag_s)
    later = _follow(command, t, y, dead_s + _STEP_S, lag_s)[2][:, 0]
    slower = _follow(command, t, y, dead_s, lag_s + _STEP_S)[2][:, 0]
    slopes = gain * (np.column_stack([later, slower]) - design[:, :1]) / _STEP_S
    spread_s = _left_out(t, residual, np.column_stack([slopes, design]), np.array([1.0, 1.0, 0.0, 0.0, 0.0]))
    return Delay(dead_s + lag_s, spread_s, float(gain), _misfit(t, y, residual))


def _coarse(command: Command, t: Array, y: Array) -> float:
    """Return the best delay on a grid, without a lag."""
    delays = np.arange(_EARLIEST_S, _LATEST_S, 0.02)
    errors = []
    for delay_s in delays:
        design = np.column_stack([command.path(t - delay_s), np.ones_like(t), t - t.mean()])
        errors.append(float(np.sum((y - design @ np.linalg.lstsq(design, y, rcond=None)[0]) ** 2)))
    return float(delays[np.argmin(errors)])


def _follow(command: Command, t: Array, y: Array, dead_s: float, lag_s: float) -> tuple[Array, Array, Array]:
    """Return (residuals, (gain, offset, drift), design) with the best gain, offset and drift."""
    design = np.column_stack([command.lagged(t - dead_s, lag_s), np.ones_like(t), t - t.mean()])
    best = np.linalg.lstsq(design, y, rcond=None)[0]
    return y - design @ best, best, design


def _left_out(t: Array, residual: Array, slopes: Array, of: Array) -> float:
    """Return half of the 95 % interval of a sum of parameters, by leaving out each eighth of the time."""
    part = np.minimum(((t - t[0]) / (t[-1] - t[0]) * _BLOCKS).astype(int), _BLOCKS - 1)
    change = np.array(
        [of @ np.linalg.lstsq(slopes[part != k], residual[part != k], rcond=None)[0] for k in range(_BLOCKS)]
    )
    return _STUDENT_7 * math.sqrt((_BLOCKS - 1) / _BLOCKS * float(np.sum((change - change.mean()) ** 2)))


def _misfit(t: Array, y: Array, residual: Array) -> float:
    level = float(np.std(y - np.polyval(np.polyfit(t, y, 1), t)))
    return float(np.sqrt(np.mean(residual**2))) / max(level, 1e-12)


def fit_response(t_s: Array, path: Array, seen: Array, longest_s: float) -> Delay:
    """Fit the mean delay of a signal behind another at the same sample times, for any shape of response.

    The impulse response is fitted sample by sample up to `longest_s`; its first moment is the delay.

    Args:
        t_s: (n,) evenly spaced times, s.
        path: (n,) path of the leading signal.
        seen: (n,) path of the delayed signal.
        longest_s: length of the response.
    """
    period_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else math.inf
    delays = np.arange(0.0, longest_s, period_s)
    late = t_s >= t_s[0] + longest_s if len(t_s) else np.zeros(0, dtype=bool)
    if late.sum() < 10 * _BLOCKS:
        return _NOTHING
    t, y = t_s[late], seen[late]
    shifted = [np.interp(t - delay_s, t_s, path) for delay_s in delays]
    design = np.column_stack([*shifted, np.ones_like(t), t - t.mean()])
    best = np.linalg.lstsq(design, y, rcond=None)[0]
    residual, response = y - design @ best, best[: len(delays)]
    gain = float(response.sum())
    delay_s = float(delays @ response) / gain
    of = np.concatenate([(delays - delay_s) / gain, [0.0, 0.0]])
    return Delay(delay_s, _left_out(t, residual, design, of), gain, _misfit(t, y, residual))


def fit_driven(
    t_s: Array, angle_rad: Array, seen_s: Array, seen_rad: Array, *, slack_rad: float, about_s: float
) -> Delay:
    """Fit the delay of axis angles behind the angles that drive them through some backlash.

    Only intervals count in which an axis is turning and has turned by `slack_rad` since it last stood:
    there backlash is an offset for each direction, fitted like the gain. NaN with too few such samples.

    Args:
        t_s: (n,) times of the driving angles, s.
        angle_rad: (n, 4) driving angles.
        seen_s: (m,) times of the driven angles, s.
        seen_rad: (m, 4) driven angles.
        slack_rad: an angle larger than the backlash.
        about_s: initial guess of the delay.
    """
    from scipy.interpolate import CubicSpline  # takes 0.5 s to import, too

    spline = CubicSpline(t_s, angle_rad)
    direction = _directions(t_s, angle_rad, spline(t_s, 1), slack_rad)
    found = Delay(about_s, math.nan, math.nan, math.nan)
    for _ in range(_ROUNDS):
        at = seen_s - found.delay_s
        k = np.clip(np.searchsorted(t_s, at) - 1, 0, len(t_s) - 2)
        driven = np.where(direction[k] == direction[k + 1], direction[k], 0)
        driven[(at < t_s[0]) | (at > t_s[-1])] = 0
        row, axis = np.nonzero((driven != 0) & np.isfinite(seen_rad))
        if len(row) < 10 * _BLOCKS:
            return _NOTHING
        kind = 2 * axis + (driven[row, axis] > 0)
        angle, rate = spline(at)[row, axis], spline(at, 1)[row, axis]
        design = np.hstack([angle[:, None] * (axis[:, None] == np.arange(4)), kind[:, None] == np.arange(8)])
        step = _later(seen_s[row], seen_rad[row, axis], design, rate, axis)
        found = replace(step, delay_s=found.delay_s + step.delay_s)
    return found


def _later(t: Array, y: Array, design: Array, rate: Array, axis: npt.NDArray[np.intp]) -> Delay:
    """Return one step towards the delay; the design holds gains by axis, offsets by axis and direction."""
    best = np.linalg.lstsq(design, y, rcond=None)[0]
    residual = y - design @ best
    slopes = np.column_stack([-best[axis] * rate, design])
    step_s = float(np.linalg.lstsq(slopes, residual, rcond=None)[0][0])
    spread_s = _left_out(t, residual, slopes, np.eye(slopes.shape[1])[0])
    return Delay(step_s, spread_s, float(best[:4].mean()), _misfit(t, y, residual))


def _directions(t_s: Array, angle_rad: Array, rate_rad_s: Array, slack_rad: float) -> Array:
    """Return the (n, 4) driving direction of each axis: 1, -1, or 0 at rest and within the slack."""
    direction = np.where(np.abs(rate_rad_s) > _DRIVEN_RAD_S, np.sign(rate_rad_s), 0.0).astype(int)
    for axis in range(direction.shape[1]):
        column, begin = direction[:, axis], 0
        for end in [*(np.flatnonzero(np.diff(column)) + 1), len(t_s)]:
            turned = np.abs(angle_rad[begin:end, axis] - angle_rad[begin, axis])
            column[begin:end][turned < slack_rad] = 0
            begin = end
    return direction
