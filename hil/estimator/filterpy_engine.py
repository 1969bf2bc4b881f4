"""The same filter with filterpy's predict and update steps, around filterpy's known defects.

filterpy's UKF keeps the sigma points of the prediction through several updates, averages with the plain
weighted sum (W_0 = -1e6 cancels), neither symmetrises nor gates, and fails on a singular covariance. Here the
points are drawn anew before every use, means are summed relative to the centre point, the square root accepts
singular matrices, and rows are gated before the update. This engine is slow. It is the reference that the
compiled engine is tested against, to 1e-9.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from hil.config.estimator import EstimatorConfig
from hil.core.clock import NS_PER_S
from hil.core.geometry import Array, Bools
from hil.core.named_records import Records
from hil.estimator import constant_twist, event_loop, pose_correction, sensors
from hil.estimator.event_buffer import History
from hil.estimator.event_loop import NONE_ACCEPTED
from hil.estimator.fusion import FilterBackend, Now
from hil.estimator.kalman_update import zero_negative_variances
from hil.estimator.matrix_loops import square_root
from hil.estimator.process_model import add_noise
from hil.estimator.sensors import (
    GATED_TOGETHER,
    MARK,
    account,
    admit,
    jacobian,
    new_frame,
    observe,
    predicted,
    reanchor,
    remember,
)
from hil.estimator.sensors.sensor import DUPLICATE, NEW_FRAME, USED
from hil.estimator.sensors.wheels import nominal
from hil.estimator.state_vector import AUX, ROWS, SCALE, STATES
from hil.support.numba_jit import kernel

compare, innovation = kernel(event_loop.compare), kernel(sensors.innovation)
move, transition = kernel(constant_twist.move), kernel(constant_twist.transition)
is_lost, is_unsure = kernel(pose_correction.is_lost), kernel(pose_correction.is_unsure)
correct_along_arc, transport_covariance = (
    kernel(pose_correction.correct_along_arc),
    kernel(pose_correction.transport_covariance),
)


def _symmetric(p: Array) -> Array:
    return np.asarray(0.5 * (p + p.T), dtype=np.float64)


def upper_root(p: Array) -> Array:
    """Upper root U (n, n) with U' U = P (n, n), the form filterpy needs; P may be singular."""
    root = np.zeros_like(p)
    square_root(p, root)
    return root


def centred_transform(
    points: Array, mean_weights: Array, spread_weights: Array, noise: Array, *_: object
) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) of 2 n + 1 sigma points (2 n + 1, n), relative to the centre point.

    In a plain weighted sum W_0 = -1e6 cancels against the other weights. Here W_0 multiplies only the square
    of the mean's offset from the centre.
    """
    away = points[1:] - points[0]
    offset = mean_weights[1:] @ away
    away = away - offset
    centre = spread_weights[0] * np.outer(offset, offset)
    return points[0] + offset, (away.T * spread_weights[1:]) @ away + centre + noise


@dataclass
class Rows:
    """Measured rows of one sample: z (8,), variances (8,), auxiliary figures (5,), number of rows."""

    z: Array
    var: Array
    aux: Array
    count: int


def accepted(nu: Array, s: Array, usable: Bools, gate: float, nis: Array) -> list[int]:
    """Indices of the rows of nu (8,), covariance s (8, 8), that pass the gate in turn; fills nis (8,)."""
    used: list[int] = []
    for i in np.flatnonzero(usable).tolist():
        known = s[np.ix_(used, used)]
        pull = np.linalg.solve(known, s[used, i]) if used else np.zeros(0)
        nis[i] = (nu[i] - pull @ nu[used]) ** 2 / (s[i, i] - pull @ s[used, i])
        if nis[i] <= gate:
            used.append(i)
    return used


@kernel
def before(
    number: int, t_ns: float, m: Records, row: Records, par: Records, z: Array, var: Array, aux: Array
) -> tuple[int, int]:
    """First part of `event_loop.run` for a sample: the result of `admit`, and the number of rows to compare.

    Memory, row and parameters are arrays (1,), here and below: these pass faster than single records.
    """
    use = admit(number, t_ns, m[0], row[0], par[0])
    if use == DUPLICATE:
        m[0].duplicates += 1.0
    count = observe(number, t_ns, m[0], row[0], par[0], z, var, aux) if use == USED else 0
    return use, count


@kernel
def counted(
    number: int, m: Records, par: Records, nu: Array, nis: Array, var: Array, count: int, gate: float
) -> None:
    """Call `Sensor.account` with `nu`, `nis` and `var` (8,), and count the accepted rows."""
    m[0].accepted += account(number, m[0], nu, nis, var, count, gate, par[0].filter.samples)


@kernel
def after(
    number: int, use: int, t_ns: float, x: Array, p: Array, m: Records, row: Records, par: Records
) -> None:
    """Last part of `event_loop.run` for a sample, on state (20,) and covariance (20, 20), in place."""
    if use == USED and reanchor(number, par[0].filter.limit, t_ns, p, m[0], par[0]):
        use = NEW_FRAME
    if use == NEW_FRAME:
        new_frame(number, t_ns, x, p, m[0], row[0], par[0])
    if use in (USED, NEW_FRAME):
        remember(number, t_ns, x, p, m[0], row[0], par[0])
        m[0].guarded += zero_negative_variances(p)


@kernel
def rows_at(number: int, points: Array, aux: Array, par: Records) -> Array:
    """Predicted rows (n, 8) at states (n, 20)."""
    out = np.zeros((points.shape[0], ROWS))
    for k in range(points.shape[0]):
        predicted(number, points[k], aux, par[0], out[k])
    return out


@kernel
def slopes_at(number: int, x: Array, aux: Array, par: Records) -> Array:
    """Derivative (8, 20) of the predicted rows at a state (20,)."""
    h = np.zeros((ROWS, STATES))
    jacobian(number, x, aux, par[0], h)
    return h


@kernel
def rolling(t_ns: float, x: Array, m: Records, par: Records, out: Array) -> None:
    """Kernel of `sensors.wheels.nominal`: fill `out` (2,) with the velocity, m/s, body frame; state (20,)."""
    nominal(t_ns, x, m[0].wheels, par[0].wheels, out)


@kernel
def noise_at(x: Array, dt_s: float, par: Records) -> Array:
    """Process noise (20, 20) of a step that starts at a state (20,)."""
    q = np.zeros((STATES, STATES))
    add_noise(x, q, dt_s, par[0].process)
    return q


class FilterpyFilter(FilterBackend):
    """Runs events through filterpy's EKF or UKF; the UKF uses the EKF while the heading is lost."""

    def __init__(self, par: Records, config: EstimatorConfig) -> None:
        by, process, n = par[0].filter, par[0].process, STATES
        self._par, self._slip_s, self._scaled = par, float(process.slip_s), float(process.scaled)
        self._scale, self._nominal = 0.0, np.zeros(2)
        self._gate_row, self._gate_pose = float(by.gate_row), float(by.gate_pose)
        self._unscented = config.kind == "ukf"
        points = MerweScaledSigmaPoints(n, config.alpha, config.beta, config.kappa, sqrt_method=upper_root)
        self._by_points: Any = UnscentedKalmanFilter(n, ROWS, 1.0, hx=None, fx=self._moved, points=points)
        self._by_slopes: Any = ExtendedKalmanFilter(n, ROWS)
        self._by_slopes.predict_x = self._predict_mean
        self._step_s = 0.0

    def run(self, history: History, begin: int, zero_ns: int, now_ns: int, now: Now) -> None:
        """Process the events of the history one by one in Python."""
        h, capacity = history, len(history.t_ns)
        for k in range(begin, h.count):
            i, j = (h.first + k) % capacity, (h.first + k - 1) % capacity
            h.x[i], h.p[i], h.m[i] = h.x[j], h.p[j], h.m[j]
            stamp, one = float(h.t_ns[i] - zero_ns), slice(i, i + 1)
            rolling(stamp, h.x[i], h.m[one], self._par, self._nominal)
            self.advance(h.x[i], h.p[i], (int(h.t_ns[i]) - int(h.t_ns[j])) * 1e-9)
            if h.numbers[i] != MARK:
                number = int(h.numbers[i])
                self._take(number, stamp, h.x[i], h.p[i], h.m[one], h.rows[one])
        now.x[:], now.p[:], now.m[0] = h.x[h.newest], h.p[h.newest], h.m[h.newest]
        rolling(float(now_ns - zero_ns), now.x, now.m, self._par, self._nominal)
        self.advance(now.x, now.p, (now_ns - int(h.t_ns[h.newest])) / NS_PER_S)

    def advance(self, x: Array, p: Array, dt_s: float) -> None:
        """Predict the state (20,) and its covariance (20, 20) by `dt_s` with filterpy, in place."""
        if dt_s <= 0.0:
            return
        unscented = self._draws_points(p, dt_s)
        f = self._by_points if unscented else self._by_slopes
        f.x, f.P, self._scale = x.copy(), p.copy(), float(x[SCALE])
        f.Q = noise_at(x, dt_s, self._par)
        if unscented:
            f.predict(dt=dt_s, UT=centred_transform)
        else:
            f.F = transition(x, dt_s, self._slip_s, self._scaled, self._nominal)
            self._step_s = dt_s
            f.predict()
        x[:], p[:] = f.x, _symmetric(f.P)

    def _draws_points(self, p: Array, dt_s: float = 0.0) -> bool:
        return self._unscented and not is_lost(p, dt_s)

    def _moved(self, x: Array, dt_s: float) -> Array:
        out = np.array(x)
        move(out, dt_s, self._slip_s, self._scaled, self._scale, self._nominal)
        return out

    def _predict_mean(self, u: float = 0.0) -> None:
        move(self._by_slopes.x, self._step_s, self._slip_s, self._scaled, self._scale, self._nominal)

    def _take(self, number: int, t_ns: float, x: Array, p: Array, m: Records, row: Records) -> None:
        """Process one sample as `event_loop.run` does, with filterpy for the update.

        filterpy can linearise at the mean only. While the heading is unsure the compiled kernel does the
        update.
        """
        r = Rows(np.zeros(ROWS), np.zeros(ROWS), np.zeros(AUX), 0)
        use, r.count = before(number, t_ns, m, row, self._par, r.z, r.var, r.aux)
        if r.count > 0 and not self._draws_points(p) and is_unsure(number, p):
            compare(number, t_ns, x, p, m[0], row[0], self._par[0], None)
        elif r.count > 0:
            self._compare(number, x, p, m, r)
        after(number, use, t_ns, x, p, m, row, self._par)

    def _compare(self, number: int, x: Array, p: Array, m: Records, r: Rows) -> None:
        """Update as `event_loop.compare`: gate the rows, then one stacked update with those that passed."""
        (mean, s), shown = self._innovation(number, x, p, r), np.zeros(ROWS)
        innovation(number, r.z, mean, r.var, r.count, shown)
        nu, nis, gate = shown[: r.count], np.full(ROWS, -1.0), self._gate_row
        if GATED_TOGETHER[number]:
            nis[:], gate = 0.0, np.inf
            nis[0] = float(nu @ np.linalg.solve(s, nu))
            if nis[0] > self._gate_pose:
                gate = NONE_ACCEPTED
        if gate > 0.0:
            used = accepted(nu, s, r.var[: r.count] >= 0.0, gate, nis)
            if used:
                self._update(number, x, p, r, nu, used)
        counted(number, m, self._par, shown, nis, r.var, r.count, gate)

    def _seen(self, number: int, points: Array, r: Rows) -> Array:
        """Predicted rows (n, count) at states (n, 20)."""
        seen = rows_at(number, np.ascontiguousarray(points), r.aux, self._par)
        return np.ascontiguousarray(seen[:, : r.count])

    def _derivative(self, number: int, x: Array, r: Rows) -> Array:
        """Derivative (count, 20) of the predicted rows at a state (20,)."""
        return slopes_at(number, x, r.aux, self._par)[: r.count]

    def _innovation(self, number: int, x: Array, p: Array, r: Rows) -> tuple[Array, Array]:
        """Predicted rows (8,), zero beyond `count`, and the innovation covariance (count, count)."""
        noise, mean = np.diag(r.var[: r.count]), np.zeros(ROWS)
        if self._draws_points(p):
            f = self._by_points
            points = f.points_fn.sigma_points(x, p)
            seen = self._seen(number, points, r)
            mean[: r.count], s = centred_transform(seen, f.Wm, f.Wc, noise)
            return mean, s
        mean[: r.count] = self._seen(number, x[None], r)[0]
        h = self._derivative(number, x, r)
        return mean, h @ p @ h.T + noise

    def _update(self, number: int, x: Array, p: Array, r: Rows, nu: Array, used: list[int]) -> None:
        """Update with filterpy, in place, from innovations already wrapped; draws new sigma points."""
        unscented, noise = self._draws_points(p), np.diag(r.var[used])
        f = self._by_points if unscented else self._by_slopes
        f.x, f.P = x.copy(), p.copy()
        if unscented:
            f.residual_z = np.subtract
            f.sigmas_f = f.points_fn.sigma_points(f.x, f.P)
            seen = np.ascontiguousarray(self._seen(number, f.sigmas_f, r)[:, used])
            mean = centred_transform(seen, f.Wm, f.Wc, noise)[0]
            f.update(
                mean + nu[used],
                R=noise,
                UT=centred_transform,
                hx=lambda point: self._seen(number, point[None], r)[0][used],
            )
        else:
            f.update(
                nu[used],
                lambda x: self._derivative(number, x, r)[used],
                lambda x: np.zeros(len(used)),
                R=noise,
            )
        before = x.copy()
        x[:], p[:] = f.x, _symmetric(f.P)
        if not unscented:
            correct_along_arc(before, x)
            transport_covariance(before, x, p)
