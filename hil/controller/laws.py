"""Control laws: compute a commanded body twist from pose error and reference.

Pose error in the measured body frame: e = (R(th)' (p_d - p), wrap(th_d - th)); reference twist t_d in
the reference's body frame.
"""

from abc import abstractmethod
from collections.abc import Callable
from functools import lru_cache
from struct import Struct
from typing import Protocol

import numpy as np

from hil.core.geometry import Array, Three, rotation2, wrap
from hil.core.signals import Reference, RobotState

_NINE = Struct("9d")
"""Packs numbers into an existing array in a third of the time of making a new one."""
_STEADY_S = 5.0
"""Extra horizon after the end of the path, so that the gains are steady at its end."""
_STILL = 1e-13
"""Relative change of the cost in one step below which it stands still; it rounds to that."""


def pose_error(state: RobotState, reference: Reference) -> Three:
    """Reference minus state (m, m, rad) in the measured body frame, heading wrapped."""
    (x, y, theta), (x_d, y_d, theta_d) = state.pose_body_in_wall.tolist(), reference.pose_in_wall.tolist()
    ahead_m, left_m = rotation2(-theta).dot((x_d - x, y_d - y)).tolist()
    return ahead_m, left_m, wrap(theta_d - theta)


def outside_dead_zone(error: Three, dead_zone: Three) -> Three:
    """Part of an error that exceeds a dead zone: zero inside, continuous at its edge."""
    (ahead, left, turn), (ahead_zone, left_zone, turn_zone) = error, dead_zone
    return ahead - clip(ahead, ahead_zone), left - clip(left, left_zone), turn - clip(turn, turn_zone)


def clip(value: float, limit: float) -> float:
    """The value clipped to [-limit, limit]."""
    return limit if value > limit else -limit if value < -limit else value


class Law(Protocol):
    """A tracking law; may keep state between calls. Errors are (m, m, rad), body axes."""

    @abstractmethod
    def reset(self) -> None:
        """Reset all state."""

    @abstractmethod
    def twist(self, error: Three, reference: Reference) -> Array:
        """Commanded body twist (3,) for an error."""

    @abstractmethod
    def learn(self, error: Three) -> None:
        """Add an error to the integral, if there is one.

        Called after `twist`, only in cycles whose command the wheels can follow (anti-windup): an integral
        that also grew at rest, at a limit or while modules steer would overshoot afterwards.
        """


class NonlinearLaw(Law):
    """Model-based law t = t_d + K e, the body form of the authors' per-wheel law.

    With V = |e|^2 / 2, V' = -e' K e without slip. A slip velocity d leaves a steady error e = d / k (beyond
    the dead zone, which the caller subtracts).
    """

    def __init__(self, gains: tuple[float, float, float]) -> None:
        self.gains = np.array(gains)

    def reset(self) -> None:
        """Do nothing: this law has no state."""

    def twist(self, error: Three, reference: Reference) -> Array:
        """Body twist (3,): feed-forward plus proportional correction."""
        return np.asarray(reference.twist_body + self.gains * error, dtype=np.float64)

    def learn(self, error: Three) -> None:
        """Do nothing: this law has no integral."""


@lru_cache(maxsize=4096)
def lag_model(omega_rad_s: float, dt_s: float, lag_s: float) -> tuple[Array, Array]:
    """Discrete A (9, 9) and B (9, 3) of z = (e, integral of e, lagged correction), input: correction.

    e' = -w S e - v, q' = e, v' = (u - v) / lag; exact discretisation by the matrix exponential. The arrays
    are cached and shared between callers, so they are read-only.

    Args:
        omega_rad_s: turn rate of the reference, rad/s.
        dt_s: period of the loop, s.
        lag_s: time constant of the drives, s.
    """
    from scipy.linalg import expm

    a = np.zeros((12, 12))
    a[0, 1], a[1, 0] = omega_rad_s, -omega_rad_s
    a[0:3, 6:9] = -np.eye(3)
    a[3:6, 0:3] = np.eye(3)
    a[6:9, 6:9] = -np.eye(3) / lag_s
    a[6:9, 9:12] = np.eye(3) / lag_s
    step = expm(a * dt_s)
    model = np.ascontiguousarray(step[:9, :9]), np.ascontiguousarray(step[:9, 9:])
    for matrix in model:
        matrix.flags.writeable = False
    return model


def riccati_gains(models: list[tuple[Array, Array]], state_cost: Array, input_cost: Array) -> list[Array]:
    """Finite-horizon time-varying LQR gains K_k (3, k), u = -K_k z, by the backward recursion from S_N = Q.

    K_k = (R + B'S B)^-1 B'S A; S <- Q + A'S (A - B K_k). Where one model lasts until S stands still, one
    matrix is the gain of all earlier steps with it.

    Args:
        models: A (k, k) and B (k, 3) of each step; alike steps have the same arrays.
        state_cost: Q, (k, k).
        input_cost: R, (3, 3).
    """
    s = state_cost.copy()
    gains: list[Array] = []
    lasting: Array | None = None
    for a, b in reversed(models):
        if a is lasting:
            gains.append(gains[-1])
            continue
        bs, before = b.T @ s, s
        gain = np.linalg.solve(input_cost + bs @ b, bs @ a)
        s = state_cost + a.T @ s @ (a - b @ gain)
        s = 0.5 * (s + s.T)
        gains.append(np.asarray(gain, dtype=np.float64))
        lasting = a if np.abs(s - before).max() <= _STILL * np.abs(s).max() else None
    return gains[::-1]


@lru_cache(maxsize=16)
def gains_along(
    omegas_rad_s: tuple[float, ...], dt_s: float, lag_s: float, weights: tuple[float, float, float]
) -> tuple[Array, ...]:
    """Feedback matrices (3, 9) on the state (9,) of `lag_model` at each step: -K_k of `riccati_gains`.

    They are cached and shared between runs along the same path, so they are read-only.

    Args:
        omegas_rad_s: turn rate of the reference at each step, rad/s.
        dt_s: period of the loop, s.
        lag_s: time constant of the drives, s.
        weights: (state, integral, input) diagonal weights; integral 0 switches it off.
    """
    q, q_i, r = weights
    known = {omega: lag_model(omega, dt_s, lag_s) for omega in dict.fromkeys(omegas_rad_s)}
    if q_i == 0.0:
        known = {omega: _without_integral(model) for omega, model in known.items()}
    state_cost = np.diag([q] * 3 + [q_i] * 3 + [0.0] * 3)
    gains = riccati_gains([known[omega] for omega in omegas_rad_s], state_cost, r * np.eye(3))
    feedback = {id(gain): -gain for gain in gains}
    for matrix in feedback.values():
        matrix.flags.writeable = False
    return tuple(feedback[id(gain)] for gain in gains)


class OptimalLaw(Law):
    """Time-varying LQR about the reference, with the servo lag in its model and optional integral action.

    Args:
        omega_at: reference turn rate by time, rad/s.
        duration_s: horizon; afterwards the steady gain is kept.
        dt_s: control period.
        lag_s: lag between command and motion.
        weights: (state, integral, input) diagonal weights; integral 0 switches it off.
        clamp: largest magnitude of the integral states.
    """

    def __init__(
        self,
        omega_at: Callable[[float], float],
        duration_s: float,
        *,
        dt_s: float,
        lag_s: float,
        weights: tuple[float, float, float],
        clamp: float,
    ) -> None:
        steps = max(2, round(duration_s / dt_s) + 2)
        times_s = (min(k * dt_s, duration_s) for k in range(steps))
        omegas = [round(float(omega_at(t_s)), 4) + 0.0 for t_s in times_s]  # -0.0 becomes 0.0, for the cache
        beyond_the_end = [omegas[-1]] * round(_STEADY_S / dt_s)
        self._gains = gains_along((*omegas, *beyond_the_end), dt_s, lag_s, weights)[:steps]
        self._dt_s, self._clamp, self._decay = dt_s, clamp, float(np.exp(-dt_s / lag_s))
        self._integrates = weights[1] > 0.0
        self._z = np.zeros(9)
        self._packed_z = self._z.data
        self.reset()

    def reset(self) -> None:
        """Reset integral and lag states to zero."""
        self._integral: Three = (0.0, 0.0, 0.0)
        self._lagged: Three = (0.0, 0.0, 0.0)

    def twist(self, error: Three, reference: Reference) -> Array:
        """Body twist (3,): feed-forward plus optimal correction."""
        k, last = round(reference.t_s / self._dt_s), len(self._gains) - 1
        k = 0 if k < 0 else last if k > last else k
        _NINE.pack_into(self._packed_z, 0, *error, *self._integral, *self._lagged)
        correction: Array = self._gains[k].dot(self._z)
        keep, take = self._decay, 1.0 - self._decay
        (x, y, turn), (new_x, new_y, new_turn) = self._lagged, correction.tolist()
        self._lagged = keep * x + take * new_x, keep * y + take * new_y, keep * turn + take * new_turn
        return reference.twist_body + correction

    def learn(self, error: Three) -> None:
        """Integrate the error over one step, within the clamp."""
        if self._integrates:
            dt_s, most, (x, y, turn) = self._dt_s, self._clamp, self._integral
            ahead, left, turned = error
            grown = x + ahead * dt_s, y + left * dt_s, turn + turned * dt_s
            self._integral = clip(grown[0], most), clip(grown[1], most), clip(grown[2], most)


def _without_integral(model: tuple[Array, Array]) -> tuple[Array, Array]:
    a, b = model[0].copy(), model[1].copy()
    a[3:6], b[3:6] = 0.0, 0.0
    return a, b
