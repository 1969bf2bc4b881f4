"""`FusionEstimator`: takes a cycle's measurements, rewinds to the oldest new one, replays, reports.

The filter itself is an `Engine`: `compiled` kernels or filterpy. Deterministic; the arrival order of
samples does not change a bit of the state.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Protocol

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.estimator import layout as L
from hil.estimator.history import History
from hil.estimator.intake import REASONS, Intake
from hil.estimator.replay import run_to
from hil.robot.kinematics import WheelGeometry
from hil.vocabulary.clock import NS_PER_S, nanoseconds
from hil.vocabulary.errors import UsageError
from hil.vocabulary.geometry import Array
from hil.vocabulary.interfaces import Estimator
from hil.vocabulary.signals import Measurements, RobotState

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
_PLACES = np.array(tuple(_FIGURES.values()))
_REJECTED = {name: f"rejected_{name}" for name in REASONS}
_AGES = {name: f"age_{name}_s" for name in L.SENSORS}


class Now:
    """The newest state and sensor memory, at the time of the cycle.

    Attributes:
        figures: (97,) memory, state and what is derived of them, as the diagnostics pick from it.
        x, p, m: (20,), (20, 20), (72,); x and m are parts of `figures`.
    """

    def __init__(self) -> None:
        self.figures = np.zeros(_AFTER + 5)
        self.m, self.x = self.figures[: L.MEMORY], self.figures[L.MEMORY : _AFTER]
        self.p = np.zeros((L.STATES, L.STATES))


class Engine(Protocol):
    """How events are run through the filter."""

    @abstractmethod
    def run(self, history: History, begin: int, zero_ns: int, now_ns: int, now: Now) -> None:
        """Replay the events of a history from `begin` to its end; `now` is its last state at `now_ns`."""


class CompiledEngine(Engine):
    """The kernels of `hil.estimator.replay`."""

    def __init__(self, par: Array, wheels: Array, rows: Array) -> None:
        self._par, self._wheels, self._rows = par, wheels, rows

    def run(self, history: History, begin: int, zero_ns: int, now_ns: int, now: Now) -> None:
        """One call for the whole stretch."""
        h = history
        run_to(
            h.marks, begin, zero_ns, h.t_ns, h.kinds, h.data, h.x, h.p, h.m,
            self._par, self._wheels, self._rows, now_ns, now.x, now.p, now.m,
        )  # fmt: skip


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
        self._intake = Intake(config)
        self.history = History(nanoseconds(config.time.history_s))
        self._now = Now()
        self._now.figures[_AFTER : _AFTER + 2] = config.gates.one_dof, config.gates.three_dof
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
        h, now = self.history, self._now
        begin = h.enter(self._intake.stage(measurements, h.base_ns), measurements.t_ns)
        self.engine.run(h, begin, self._zero_ns, measurements.t_ns, now)
        return RobotState(
            t_ns=measurements.t_ns,
            pose_body_in_wall=now.x[:3].copy(),
            twist_body=now.x[3:6].copy(),
            covariance=now.p[:6, :6].copy(),
            diagnostics=self._diagnostics(measurements.t_ns) if self._diagnosed else {},
        )

    def _diagnostics(self, t_ns: int) -> dict[str, float]:
        """Figures by name, in this order: what the sensors said, what was refused, ages."""
        now, intake, figures = self._now, self._intake, self._now.figures
        figures[_AFTER + 2] = -figures[L.MEMORY + L.SLIP_X]
        for k, place in ((3, L.SCALE), (4, L.SLIP_X)):
            figures[_AFTER + k] = math.sqrt(max(now.p.item(place, place), 0.0))
        out: dict[str, float] = dict(zip(_FIGURES, figures.take(_PLACES).tolist(), strict=True))
        _, _, late, duplicate = self.history.marks.tolist()
        for name, count in intake.refused.items():
            out[_REJECTED[name]] = float(count)
        out["rejected_late"] += late
        out["rejected_duplicate"] += duplicate
        if self.config.time.clock == "estimated":
            for name, clock in intake.clocks.items():
                out[f"clock_offset_{name}_s"], out[f"clock_drift_{name}"] = clock.offset_s, clock.drift
        for name, last_ns in intake.last_ns.items():
            out[_AGES[name]] = (t_ns - last_ns) / NS_PER_S
        return out


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
