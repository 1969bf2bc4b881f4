"""The same filter on filterpy: its predict and update steps, our models, its defects avoided.

filterpy's UKF keeps the sigma points of the prediction through several updates, averages with the plain
weighted sum (W_0 = -1e6 cancels), neither symmetrises nor gates, and fails on a singular covariance. Here
the points are drawn anew before every use, means are summed relative to the centre point, the square root
accepts singular matrices, and rows are gated before the update.
Slow: it is the reference that the compiled engine is held against, to 1e-9.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from hil.estimator import sensors
from hil.estimator.conditioning import guard
from hil.estimator.events import NONE_ACCEPTED
from hil.estimator.fusion import Engine, Now
from hil.estimator.history import History
from hil.estimator.layout import EventRow, Memory, Parameters
from hil.estimator.process import add_noise, move, transition
from hil.estimator.sensors.sensor import DUPLICATE, NEW_FRAME, REFUSED
from hil.estimator.small_matrices import square_root
from hil.estimator.state import ROWS, STATES
from hil.vocabulary.clock import NS_PER_S
from hil.vocabulary.geometry import Array

Bools = npt.NDArray[np.bool_]


def _symmetric(p: Array) -> Array:
    return np.asarray(0.5 * (p + p.T), dtype=np.float64)


def upper_root(p: Array) -> Array:
    """U with U' U = P, as filterpy wants it; a singular P is accepted."""
    return np.ascontiguousarray(square_root(p, len(p)).T)


def centred_transform(
    points: Array, mean_weights: Array, spread_weights: Array, noise: Array, *_: object
) -> tuple[Array, Array]:
    """Mean and covariance of sigma points, summed relative to the centre point.

    With the plain sums W_0 = -1e6 cancels against the other weights; here it only weighs the square of
    the mean's offset from the centre.
    """
    away = points[1:] - points[0]
    offset = mean_weights[1:] @ away
    away = away - offset
    centre = spread_weights[0] * np.outer(offset, offset)
    return points[0] + offset, (away.T * spread_weights[1:]) @ away + centre + noise


@dataclass
class Rows:
    """What one sample says: z and its variances (8,), the auxiliary figures, the number of rows."""

    z: Array
    var: Array
    aux: Array
    count: int


def accepted(nu: Array, s: Array, usable: Bools, gate: float, nis: Array) -> list[int]:
    """Rows that pass their gate, each judged given the accepted rows before it; fills `nis`."""
    used: list[int] = []
    for i in np.flatnonzero(usable).tolist():
        known = s[np.ix_(used, used)]
        pull = np.linalg.solve(known, s[used, i]) if used else np.zeros(0)
        nis[i] = (nu[i] - pull @ nu[used]) ** 2 / (s[i, i] - pull @ s[used, i])
        if nis[i] <= gate:
            used.append(i)
    return used


class FilterpyEngine(Engine):
    """Runs events through filterpy's EKF or UKF."""

    def __init__(self, par: Parameters) -> None:
        self._par, self._process, n = par, par.process, STATES
        self._unscented = bool(par.filter.unscented)
        if self._unscented:
            f = par.filter
            points = MerweScaledSigmaPoints(n, f.alpha, f.beta, f.kappa, sqrt_method=upper_root)
            self._filter: Any = UnscentedKalmanFilter(n, ROWS, 1.0, hx=None, fx=self._moved, points=points)
        else:
            self._filter = ExtendedKalmanFilter(n, ROWS)
            self._filter.predict_x = self._predict_mean
            self._step_s = 0.0

    def run(self, history: History, begin: int, zero_ns: int, now_ns: int, now: Now) -> None:
        """Event by event, in Python."""
        h, capacity = history, len(history.t_ns)
        for k in range(begin, h.count):
            i, j = (h.first + k) % capacity, (h.first + k - 1) % capacity
            h.x[i], h.p[i], h.m[i] = h.x[j], h.p[j], h.m[j]
            self.advance(h.x[i], h.p[i], (int(h.t_ns[i]) - int(h.t_ns[j])) * 1e-9)
            self._take(int(h.numbers[i]), float(h.t_ns[i] - zero_ns), h.x[i], h.p[i], h.m[i], h.rows[i])
        now.x[:], now.p[:], now.m[0] = h.x[h.newest], h.p[h.newest], h.m[h.newest]
        self.advance(now.x, now.p, (now_ns - int(h.t_ns[h.newest])) / NS_PER_S)

    def advance(self, x: Array, p: Array, dt_s: float) -> None:
        """Filterpy's prediction."""
        if dt_s <= 0.0:
            return
        f = self._filter
        f.x, f.P = x.copy(), p.copy()
        f.Q = np.zeros((STATES, STATES))
        add_noise(x, f.Q, dt_s, self._process)
        if self._unscented:
            f.predict(dt=dt_s, UT=centred_transform)
        else:
            f.F = transition(x, dt_s, self._process.slip_s)
            self._step_s = dt_s
            f.predict()
        x[:], p[:] = f.x, _symmetric(f.P)

    def _moved(self, x: Array, dt_s: float) -> Array:
        out = np.array(x)
        move(out, dt_s, self._process.slip_s)
        return out

    def _predict_mean(self, u: float = 0.0) -> None:
        move(self._filter.x, self._step_s, self._process.slip_s)

    def _take(self, number: int, t_ns: float, x: Array, p: Array, m: Memory, row: EventRow) -> None:
        """As `events.take`, with the comparison on filterpy."""
        if number == sensors.MARK:
            return
        use = sensors.admit(number, t_ns, m, row, self._par)
        if use == REFUSED:
            return
        if use == DUPLICATE:
            m.duplicates += 1.0
            return
        if use == NEW_FRAME:
            sensors.new_frame(number, t_ns, x, p, m, row, self._par)
        else:
            self._compare(number, t_ns, x, p, m, row)
            sensors.let_in(number, self._par.filter.limit, t_ns, x, p, m, row, self._par)
        sensors.remember(number, t_ns, x, p, m, row, self._par)
        m.guarded += guard(p)

    def _compare(self, number: int, t_ns: float, x: Array, p: Array, m: Memory, row: EventRow) -> None:
        """As `events.compare`: gates first, then one stacked update with the rows that passed."""
        by = self._par.filter
        r = Rows(np.zeros(ROWS), np.zeros(ROWS), np.zeros(2), 0)
        r.count = sensors.observe(number, t_ns, m, row, self._par, r.z, r.var, r.aux)
        if r.count == 0:
            return
        mean, s = self._innovation(number, x, p, r)
        nu = sensors.innovation(number, m, r.z, mean, r.var, r.count)[: r.count]
        usable = r.var[: r.count] >= 0.0
        nis, gate = np.full(ROWS, -1.0), by.gate_row
        if sensors.GATED_TOGETHER[number]:
            nis[:] = 0.0
            nis[0], gate = float(nu @ np.linalg.solve(s, nu)), np.inf
            if nis[0] > by.gate_pose:
                gate = NONE_ACCEPTED
        if gate > 0.0:
            used = accepted(nu, s, usable, gate, nis)
            if used:
                self._update(number, x, p, r, nu, used)
        m.accepted += sensors.account(number, m, nis, r.var, r.count, gate, by.samples)

    def _seen(self, number: int, x: Array, r: Rows) -> Array:
        out = np.zeros(ROWS)
        sensors.predicted(number, x, r.aux, self._par, out)
        return out[: r.count]

    def _derivative(self, number: int, x: Array, r: Rows) -> Array:
        h = np.zeros((ROWS, STATES))
        sensors.jacobian(number, x, r.aux, self._par, h)
        return h[: r.count]

    def _innovation(self, number: int, x: Array, p: Array, r: Rows) -> tuple[Array, Array]:
        """Predicted rows (8,), zero beyond the count, and the covariance of the innovation."""
        noise, mean = np.diag(r.var[: r.count]), np.zeros(ROWS)
        if self._unscented:
            f = self._filter
            points = f.points_fn.sigma_points(x, p)
            seen = np.array([self._seen(number, point, r) for point in points])
            mean[: r.count], s = centred_transform(seen, f.Wm, f.Wc, noise)
            return mean, s
        mean[: r.count] = self._seen(number, x, r)
        h = self._derivative(number, x, r)
        return mean, h @ p @ h.T + noise

    def _update(self, number: int, x: Array, p: Array, r: Rows, nu: Array, used: list[int]) -> None:
        """Filterpy's update with the innovation already wrapped; sigma points drawn anew."""
        f, noise = self._filter, np.diag(r.var[used])
        f.x, f.P = x.copy(), p.copy()
        if self._unscented:
            f.residual_z = np.subtract
            f.sigmas_f = f.points_fn.sigma_points(f.x, f.P)
            seen = np.array([self._seen(number, point, r)[used] for point in f.sigmas_f])
            mean = centred_transform(seen, f.Wm, f.Wc, noise)[0]
            f.update(
                mean + nu[used],
                R=noise,
                UT=centred_transform,
                hx=lambda point: self._seen(number, point, r)[used],
            )
        else:
            f.update(
                nu[used],
                lambda x: self._derivative(number, x, r)[used],
                lambda x: np.zeros(len(used)),
                R=noise,
            )
        x[:], p[:] = f.x, _symmetric(f.P)
