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

from hil.estimator import layout as L
from hil.estimator import replay as kernels
from hil.estimator.conditioning import guard
from hil.estimator.fusion import Engine, Now
from hil.estimator.history import History
from hil.estimator.process import add_noise, move, transition
from hil.estimator.sensors import jacobian, observe, predicted
from hil.estimator.small_matrices import square_root
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

    def __init__(self, par: Array, wheels: Array, rows: Array) -> None:
        self._par, self._wheels, self._rows = par, wheels, rows
        self._unscented = bool(par[L.UNSCENTED])
        n = L.STATES
        if self._unscented:
            points = MerweScaledSigmaPoints(
                n, par[L.ALPHA], par[L.BETA], par[L.KAPPA], sqrt_method=upper_root
            )
            self._filter: Any = UnscentedKalmanFilter(n, L.ROWS, 1.0, hx=None, fx=self._moved, points=points)
        else:
            self._filter = ExtendedKalmanFilter(n, L.ROWS)
            self._filter.predict_x = self._predict_mean
            self._step_s = 0.0

    def run(self, history: History, begin: int, zero_ns: int, now_ns: int, now: Now) -> None:
        """Event by event, in Python."""
        h, capacity = history, len(history.t_ns)
        for k in range(begin, h.count):
            i, j = (h.first + k) % capacity, (h.first + k - 1) % capacity
            h.x[i], h.p[i], h.m[i] = h.x[j], h.p[j], h.m[j]
            self.advance(h.x[i], h.p[i], (int(h.t_ns[i]) - int(h.t_ns[j])) * 1e-9)
            self._take(int(h.kinds[i]), float(h.t_ns[i] - zero_ns), h.x[i], h.p[i], h.m[i], h.data[i])
        now.x[:], now.p[:], now.m[:] = h.x[h.newest], h.p[h.newest], h.m[h.newest]
        self.advance(now.x, now.p, (now_ns - int(h.t_ns[h.newest])) / NS_PER_S)

    def advance(self, x: Array, p: Array, dt_s: float) -> None:
        """Filterpy's prediction."""
        if dt_s <= 0.0:
            return
        f = self._filter
        f.x, f.P = x.copy(), p.copy()
        f.Q = np.zeros((L.STATES, L.STATES))
        add_noise(x, f.Q, dt_s, self._par)
        if self._unscented:
            f.predict(dt=dt_s, UT=centred_transform)
        else:
            f.F = transition(x, dt_s, self._par[L.SLIP_S])
            self._step_s = dt_s
            f.predict()
        x[:], p[:] = f.x, _symmetric(f.P)

    def _moved(self, x: Array, dt_s: float) -> Array:
        out = np.array(x)
        move(out, dt_s, self._par[L.SLIP_S])
        return out

    def _predict_mean(self, u: float = 0.0) -> None:
        move(self._filter.x, self._step_s, self._par[L.SLIP_S])

    def _take(self, kind: int, t_ns: float, x: Array, p: Array, m: Array, data: Array) -> None:
        """As `replay.take`, with the comparison on filterpy."""
        if kind == L.RESET:
            return
        use = kernels.admit(kind, t_ns, m, data, self._par)
        if use == 0:
            m[L.REJECTED + kind] += 1.0
            return
        if use == 3:
            m[L.DUPLICATES] += 1.0
            return
        if use == 2:
            kernels.anchor(t_ns, x, p, m, data, self._par)
        else:
            self._compare(kind, t_ns, x, p, m, data)
            kernels.let_in(kind, t_ns, x, p, m, data, self._par)
        kernels.remember(kind, t_ns, x, p, m, data, self._par)
        m[L.GUARDED] += guard(p)

    def _compare(self, kind: int, t_ns: float, x: Array, p: Array, m: Array, data: Array) -> None:
        """As `replay.compare`: gates first, then one stacked update with the rows that passed."""
        par = self._par
        r = Rows(np.zeros(L.ROWS), np.zeros(L.ROWS), np.zeros(2), 0)
        r.count = observe(kind, t_ns, m, data, par, self._wheels, self._rows, r.z, r.var, r.aux)
        if r.count == 0:
            return
        mean, s = self._innovation(kind, x, p, r)
        nu = kernels.innovations(kind, r.z, mean, r.var, r.count)[: r.count]
        kernels.show_innovation(kind, nu, m)
        usable = r.var[: r.count] >= 0.0
        nis, gate = np.full(L.ROWS, -1.0), par[L.GATE1]
        if kind == L.TRACKER or kind == L.MOCAP:
            total = float(nu @ np.linalg.solve(s, nu))
            if total > par[L.GATE3]:
                kernels.tally(kind, m, total, 0, r.count, par)
                return
            gate = np.inf
        used = accepted(nu, s, usable, gate, nis)
        if used:
            self._update(kind, x, p, r, nu, used)
        kernels.account(kind, m, nis, r.var, r.count, gate, par)

    def _seen(self, kind: int, x: Array, r: Rows) -> Array:
        out = np.zeros(L.ROWS)
        predicted(kind, x, r.aux, self._par, self._rows, out)
        return out[: r.count]

    def _derivative(self, kind: int, x: Array, r: Rows) -> Array:
        h = np.zeros((L.ROWS, L.STATES))
        jacobian(kind, x, r.aux, self._par, self._rows, h)
        return h[: r.count]

    def _innovation(self, kind: int, x: Array, p: Array, r: Rows) -> tuple[Array, Array]:
        """Predicted rows (8,), zero beyond the count, and the covariance of the innovation."""
        noise, mean = np.diag(r.var[: r.count]), np.zeros(L.ROWS)
        if self._unscented:
            f = self._filter
            points = f.points_fn.sigma_points(x, p)
            seen = np.array([self._seen(kind, point, r) for point in points])
            mean[: r.count], s = centred_transform(seen, f.Wm, f.Wc, noise)
            return mean, s
        mean[: r.count] = self._seen(kind, x, r)
        h = self._derivative(kind, x, r)
        return mean, h @ p @ h.T + noise

    def _update(self, kind: int, x: Array, p: Array, r: Rows, nu: Array, used: list[int]) -> None:
        """Filterpy's update with the innovation already wrapped; sigma points drawn anew."""
        f, noise = self._filter, np.diag(r.var[used])
        f.x, f.P = x.copy(), p.copy()
        if self._unscented:
            f.residual_z = np.subtract
            f.sigmas_f = f.points_fn.sigma_points(f.x, f.P)
            seen = np.array([self._seen(kind, point, r)[used] for point in f.sigmas_f])
            mean = centred_transform(seen, f.Wm, f.Wc, noise)[0]
            f.update(
                mean + nu[used],
                R=noise,
                UT=centred_transform,
                hx=lambda point: self._seen(kind, point, r)[used],
            )
        else:
            f.update(
                nu[used], lambda x: self._derivative(kind, x, r)[used], lambda x: np.zeros(len(used)), R=noise
            )
        x[:], p[:] = f.x, _symmetric(f.P)
