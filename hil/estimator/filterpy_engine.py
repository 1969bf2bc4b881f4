"""The same filter on filterpy: its predict and update steps, our models, its defects avoided.

filterpy's UKF keeps the sigma points of the prediction through several updates, averages with the plain
weighted sum (W_0 = -1e6 cancels), neither symmetrises nor gates, and fails on a singular covariance
(`facts/estimation.md`). Here the points are drawn anew before every use, means are summed relative to the
centre point, the square root accepts singular matrices, and rows are gated before the update.
Slow: it is the reference that the compiled engine is held against, to 1e-9.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from hil.clock import NS_PER_S
from hil.estimator import layout as L
from hil.estimator import replay as kernels
from hil.estimator.conditioning import guard
from hil.estimator.fusion import Engine
from hil.estimator.history import History
from hil.estimator.process import add_noise, move, transition
from hil.estimator.unscented import square_root
from hil.geometry import Array


def _symmetric(p: Array) -> Array:
    return np.asarray(0.5 * (p + p.T), dtype=np.float64)


def _centred_mean(points: Array, weights: Array) -> Array:
    """Weighted mean relative to the centre point: exact where W_0 is a large negative number."""
    return np.asarray(points[0] + weights[1:] @ (points[1:] - points[0]), dtype=np.float64)


class FilterpyEngine(Engine):
    """Runs events through filterpy's EKF or UKF."""

    def __init__(self, par: Array, wheels: Array, rows: Array) -> None:
        self._par, self._wheels, self._rows = par, wheels, rows
        self._unscented = bool(par[L.UNSCENTED])
        n = L.STATES
        if self._unscented:
            points = MerweScaledSigmaPoints(
                n, par[L.ALPHA], par[L.BETA], par[L.KAPPA], sqrt_method=lambda p: square_root(p).T.copy()
            )
            self._filter: Any = UnscentedKalmanFilter(
                n, L.ROWS, 1.0, hx=None, fx=None, points=points, x_mean_fn=_centred_mean,
                z_mean_fn=_centred_mean,
            )  # fmt: skip
            # filterpy hands Cholesky the scaled covariance, whose upper root it takes by rows
        else:
            self._filter = ExtendedKalmanFilter(n, L.ROWS)

    def run(self, history: History, begin: int, zero_ns: int) -> None:
        """Event by event, in Python."""
        h, capacity = history, len(history.t_ns)
        for k in range(begin, h.count):
            i, j = (h.first + k) % capacity, (h.first + k - 1) % capacity
            h.x[i], h.p[i], h.m[i] = h.x[j], h.p[j], h.m[j]
            self.advance(h.x[i], h.p[i], (int(h.t_ns[i]) - int(h.t_ns[j])) / NS_PER_S)
            self._take(int(h.kinds[i]), float(h.t_ns[i] - zero_ns), h.x[i], h.p[i], h.m[i], h.data[i])

    def advance(self, x: Array, p: Array, dt_s: float) -> None:
        """Filterpy's prediction."""
        if dt_s <= 0.0:
            return
        f, par = self._filter, self._par
        noise = np.zeros((L.STATES, L.STATES))
        add_noise(x, noise, dt_s, par)
        f.x, f.P, f.Q = x.copy(), p.copy(), noise
        if self._unscented:
            f.predict(dt=dt_s, fx=self._moved)
        else:
            f.F = transition(x, dt_s, par[L.SLIP_S])
            f.predict_x = lambda u=0: None
            move(f.x, dt_s, par[L.SLIP_S])
            f.predict()
        x[:], p[:] = f.x, _symmetric(f.P)

    def _moved(self, x: Array, dt_s: float) -> Array:
        out = np.array(x)
        move(out, dt_s, self._par[L.SLIP_S])
        return out

    def _take(self, kind: int, t_ns: float, x: Array, p: Array, m: Array, data: Array) -> None:
        """As `replay.take`, with the comparison on filterpy."""
        if kind == L.RESET:
            return
        use = kernels.admit(kind, t_ns, m, data, self._par)
        if use == 0:
            m[L.REJECTED + kind] += 1.0
        elif use == 3:
            m[L.DUPLICATES] += 1.0
        else:
            if use == 2:
                kernels.anchor(t_ns, x, p, m, data, self._par)
            else:
                self._compare(kind, t_ns, x, p, m, data)
                kernels.let_in(kind, t_ns, x, p, m, data, self._par)
            kernels.remember(kind, t_ns, x, p, m, data, self._par)
            m[L.GUARDED] += guard(p)
