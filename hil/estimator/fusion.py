"""`FusionEstimator`: takes a cycle's measurements, rewinds to the oldest new one, replays, reports.

The filter itself is an `Engine`: `compiled` kernels or filterpy. Deterministic; the arrival order of
samples does not change a bit of the state.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from operator import itemgetter
from typing import Protocol

import numpy as np

from hil.clock import NS_PER_S, nanoseconds
from hil.config.estimator import EstimatorConfig
from hil.errors import UsageError
from hil.estimator import layout as L
from hil.estimator.history import History
from hil.estimator.intake import Event, Intake
from hil.estimator.replay import advance, run
from hil.geometry import Array
from hil.interfaces import Estimator
from hil.kinematics import WheelGeometry
from hil.signals import Measurements, RobotState

_TWIST_SIGMA = 0.02
_CHECKED = 6
_AFTER = L.MEMORY + L.STATES
_FIGURES = {
    "nis_wheels": L.NIS + L.WHEELS, "nis_gyro": L.NIS + L.GYRO, "nis_tracker": L.NIS + L.TRACKER,
    "nis_gravity": L.NIS + L.GRAVITY,
    "nis_mean_wheels": L.NIS_MEAN + L.WHEELS, "nis_mean_gyro": L.NIS_MEAN + L.GYRO,
    "nis_mean_tracker": L.NIS_MEAN + L.TRACKER, "nis_mean_gravity": L.NIS_MEAN + L.GRAVITY,
    "gate_wheels": _AFTER, "gate_tracker": _AFTER + 1,
    "innovation_wheels_m": L.INNOVATION, "innovation_gyro_rad_s": L.INNOVATION + 1,
    "innovation_tracker_m": L.INNOVATION + 2,
    "rejected_wheels": L.REJECTED + L.WHEELS, "rejected_gyro": L.REJECTED + L.GYRO,
    "rejected_tracker": L.REJECTED + L.TRACKER, "rejected_gravity": L.REJECTED + L.GRAVITY,
    "rejected_mocap": L.REJECTED + L.MOCAP, "rejected_same_stamp": L.DUPLICATES,
    "reanchored_tracker": L.REANCHORED + L.TRACKER, "reanchored_wheels": L.REANCHORED + L.WHEELS,
    "guarded": L.GUARDED,
    "gyro_bias_rad_s": L.MEMORY + L.BIAS, "yaw_slip_rad_m": L.MEMORY + L.YAW_SLIP,
    "slip_up_m_s": L.MEMORY + L.SLIP_X, "slip_left_m_s": L.MEMORY + L.SLIP_Y, "sag_m_s": _AFTER + 2,
    "creep_up": L.MEMORY + L.CREEP_X, "creep_left": L.MEMORY + L.CREEP_Y,
    "scale": L.MEMORY + L.SCALE, "scale_sigma": _AFTER + 3, "sag_sigma_m_s": _AFTER + 4,
    "gravity_offset_rad": L.MEMORY + L.OFFSET,
    "rejected_wheel_fl": L.WHEEL_REJECTED, "rejected_wheel_bl": L.WHEEL_REJECTED + 1,
    "rejected_wheel_br": L.WHEEL_REJECTED + 2, "rejected_wheel_fr": L.WHEEL_REJECTED + 3,
}  # fmt: skip
_PICKED = itemgetter(*_FIGURES.values())


class Engine(Protocol):
    """How events are run through the filter."""

    @abstractmethod
    def run(self, history: History, begin: int, zero_ns: int) -> None:
        """Replay the events of a history from `begin` to its end."""

    @abstractmethod
    def advance(self, x: Array, p: Array, dt_s: float) -> None:
        """Predict one state in place."""


class CompiledEngine(Engine):
    """The kernels of `hil.estimator.replay`."""

    def __init__(self, par: Array, wheels: Array, rows: Array) -> None:
        self._par, self._wheels, self._rows = par, wheels, rows

    def run(self, history: History, begin: int, zero_ns: int) -> None:
        """One call for the whole stretch."""
        h = history
        run(
            h.first, begin, h.count, zero_ns, h.t_ns, h.kinds, h.data, h.x, h.p, h.m,
            self._par, self._wheels, self._rows,
        )  # fmt: skip

    def advance(self, x: Array, p: Array, dt_s: float) -> None:
        """Kernel prediction."""
        advance(x, p, dt_s, self._par)


class FusionEstimator(Estimator):
    """EKF or UKF over all sensors.

    Args:
        config, geometry, surface: see `hil.estimator.make_estimator`.
        engine: runs the events.
        diagnostics: whether states carry them.
    """

    def __init__(
        self, config: EstimatorConfig, geometry: WheelGeometry, surface: str, engine: Engine,
        *, diagnostics: bool = True,
    ) -> None:  # fmt: skip
        self.config, self.geometry, self.surface = config, geometry, surface
        self.engine, self._diagnosed = engine, diagnostics
        self._gates = config.gates
        self._intake = Intake(config)
        self.history = History(nanoseconds(config.time.history_s))
        self._x, self._p = np.zeros(L.STATES), np.zeros((L.STATES, L.STATES))
        self._ready = False

    def reset(self, state: RobotState) -> None:
        """Start from a known state; its covariance is that of pose and twist.

        Raises:
            UsageError: the state is not finite or its covariance is not a covariance.
        """
        x, p, m = start_of(self.config, self.surface, state)
        self._zero_ns = state.t_ns
        self._intake.reset()
        self.history.reset(state.t_ns, x, p, m)
        self._ready = True

    def update(self, measurements: Measurements) -> RobotState:
        """Take one cycle's measurements and return the state at its time."""
        if not self._ready:
            covariance = np.diag([1e-6] * 3 + [_TWIST_SIGMA**2] * 3)
            start_ns = measurements.t_ns - self.history.span_ns
            self.reset(RobotState(start_ns, np.zeros(3), np.zeros(3), covariance))
        h = self.history
        events = self._intake.events(measurements, h.base_ns)
        h.trim(max(measurements.t_ns, int(h.t_ns[h.newest])), len(events))
        begin = h.count
        for t_ns, kind, seq, row in sorted(events, key=_stamp):
            if t_ns <= h.base_ns:
                self._intake.refused["late"] += 1
                continue
            place = h.add(t_ns, kind, seq, row)
            if place < 0:
                self._intake.refused["duplicate"] += 1
            else:
                begin = min(begin, place)
        if begin < h.count:
            self.engine.run(h, begin, self._zero_ns)
        return self._state(measurements.t_ns)

    def _state(self, t_ns: int) -> RobotState:
        h, last = self.history, self.history.newest
        x, p = self._x, self._p
        x[:], p[:] = h.x[last], h.p[last]
        ahead_ns = t_ns - int(h.t_ns[last])
        if ahead_ns > 0:
            self.engine.advance(x, p, ahead_ns / NS_PER_S)
        return RobotState(
            t_ns=t_ns,
            pose_body_in_wall=x[:3].copy(),
            twist_body=x[3:6].copy(),
            covariance=p[:6, :6].copy(),
            diagnostics=self._diagnostics(t_ns, x, p, h.m[last]) if self._diagnosed else {},
        )

    def _diagnostics(self, t_ns: int, x: Array, p: Array, m: Array) -> dict[str, float]:
        """Figures by name, in this order: what the sensors said, what was refused, ages."""
        gates, slip_m_s = self._gates, float(x[L.SLIP_X])
        sigmas = (math.sqrt(max(p.item(k, k), 0.0)) for k in (L.SCALE, L.SLIP_X))
        values = (*m.tolist(), *x.tolist(), gates.one_dof, gates.three_dof, -slip_m_s, *sigmas)
        out: dict[str, float] = dict(zip(_FIGURES, _PICKED(values), strict=True))
        for name, count in self._intake.refused.items():
            out[f"rejected_{name}"] = float(count)
        if self.config.time.clock == "estimated":
            for name, clock in self._intake.clocks.items():
                out[f"clock_offset_{name}_s"], out[f"clock_drift_{name}"] = clock.offset_s, clock.drift
        for name, last_ns in self._intake.last_ns.items():
            out[f"age_{name}_s"] = (t_ns - last_ns) / NS_PER_S
        return out


def _stamp(event: Event) -> int:
    return event[0]


def start_of(config: EstimatorConfig, surface: str, state: RobotState) -> tuple[Array, Array, Array]:
    """State (20,), covariance (20, 20) and sensor memory of a filter that starts from a known state.

    Raises:
        UsageError: the state is not finite or its covariance is not a covariance.
    """
    check_state(state)
    x, p = np.zeros(L.STATES), np.diag(L.prior_variances(config, surface))
    x[:3], x[3:6] = state.pose_body_in_wall, state.twist_body
    p[:6, :6] = 0.5 * (state.covariance + state.covariance.T)
    m = np.zeros(L.MEMORY)
    m[[L.WHEEL_T, L.FRAME_T, L.TRACKER_T, L.GYRO_T, L.MOCAP_T]] = -1.0
    m[L.NIS_MEAN : L.NIS_MEAN + 6] = 1.0
    return x, p, m


def check_state(state: RobotState) -> None:
    """Refuse a start state that no filter can run from.

    Raises:
        UsageError: naming what is wrong.
    """
    pose, twist = np.asarray(state.pose_body_in_wall), np.asarray(state.twist_body)
    if pose.shape != (3,) or twist.shape != (3,) or not np.all(np.isfinite(np.r_[pose, twist])):
        raise UsageError(f"start state: pose {pose}, twist {twist}", expected="three finite numbers each")
    covariance = np.asarray(state.covariance)
    if covariance.shape != (_CHECKED, _CHECKED) or not np.all(np.isfinite(covariance)):
        raise UsageError("start state: covariance", expected="a finite 6x6 matrix of pose and twist")
    size = float(np.max(np.abs(covariance)))
    if np.max(np.abs(covariance - covariance.T)) > 1e-9 * size:
        raise UsageError("start state: covariance is not symmetric")
    least = float(np.linalg.eigvalsh(covariance)[0])
    if least < -1e-9 * size:
        raise UsageError(
            f"start state: covariance has the eigenvalue {least:.3g}", expected="none below zero"
        )
