"""`FusionEstimator`: takes a cycle's measurements, rewinds to the oldest new one, replays, reports.

The filter itself is an `Engine`: `compiled` kernels or filterpy. Deterministic; the arrival order of
samples does not change a bit of the state.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from functools import cache
from typing import Protocol

import numpy as np

from hil.config.estimator import EstimatorConfig
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.interfaces import Estimator
from hil.core.named_records import Records, place
from hil.core.signals import Measurements, RobotState
from hil.estimator.event_buffer import History
from hil.estimator.event_loop import run
from hil.estimator.initial_state import start_of
from hil.estimator.kernel_layout import MEMORY, MEMORY_FLOATS, PARAMETERS, States, first_memory
from hil.estimator.measurement_queue import REASONS, MeasurementQueue
from hil.estimator.sensors import SENSORS
from hil.estimator.state_vector import (
    BIAS,
    CREEP_X,
    CREEP_Y,
    MOTION,
    OFFSET,
    POSE,
    SCALE,
    SLIP_X,
    SLIP_Y,
    STATES,
    TWIST,
    YAW_SLIP,
)
from hil.estimator.unscented import Points
from hil.robot.kinematics import WheelGeometry
from hil.support.numba_jit import compile_for, plain

_TWIST_SIGMA = 0.02
_STATE = MEMORY_FLOATS
_GATE_ROW, _GATE_POSE, _SAG, _SCALE_SIGMA, _SAG_SIGMA = range(_STATE + STATES, _STATE + STATES + 5)
_FIGURES = {
    **{name: place(MEMORY, f"{s.NAME}.{path}") for s in SENSORS for name, path in s.FIGURES.items()},
    "rejected_same_stamp": place(MEMORY, "duplicates"),
    "guarded": place(MEMORY, "guarded"),
    "gate_wheels": _GATE_ROW,
    "gate_tracker": _GATE_POSE,
    "gyro_bias_rad_s": _STATE + BIAS,
    "yaw_slip_rad_m": _STATE + YAW_SLIP,
    "slip_up_m_s": _STATE + SLIP_X,
    "slip_left_m_s": _STATE + SLIP_Y,
    "sag_m_s": _SAG,
    "creep_up": _STATE + CREEP_X,
    "creep_left": _STATE + CREEP_Y,
    "scale": _STATE + SCALE,
    "scale_sigma": _SCALE_SIGMA,
    "sag_sigma_m_s": _SAG_SIGMA,
    "gravity_offset_rad": _STATE + OFFSET,
}
_PLACES = np.array(tuple(_FIGURES.values()))
_NAMES = (*_FIGURES, *(f"rejected_{reason}" for reason in REASONS))
_AT_SAG, _AT_SCALE_SIGMA, _AT_SAG_SIGMA, _AT_SLIP_UP = map(
    _NAMES.index, ("sag_m_s", "scale_sigma", "sag_sigma_m_s", "slip_up_m_s")
)
_AGES = {sensor.NAME: f"age_{sensor.NAME}_s" for sensor in SENSORS}


class Now:
    """The newest state and sensor memory, at the time of the cycle.

    Attributes:
        figures: memory, state and gates, as the diagnostics pick from it, and room for what they derive.
        x, p: (20,) and (20, 20); x is a part of `figures`.
        m: (1,), a part of `figures`.
        states: the three of them.
        pose, twist, covariance: (3,), (3,) and (6, 6), parts of x and p.
    """

    def __init__(self) -> None:
        self.figures = np.zeros(_SAG_SIGMA + 1)
        self.m: Records = self.figures[:_STATE].view(MEMORY)
        self.x = self.figures[_STATE : _STATE + STATES]
        self.p = np.zeros((STATES, STATES))
        self.states = States(self.x, self.p, self.m)
        self.pose, self.twist, self.covariance = self.x[POSE], self.x[TWIST], self.p[:MOTION, :MOTION]


class FilterBackend(Protocol):
    """How events are run through the filter."""

    @abstractmethod
    def run(self, history: History, begin: int, zero_ns: int, now_ns: int, now: Now) -> None:
        """Replay the events of a history from `begin` to its end; `now` is its last state at `now_ns`."""


@cache
def load_filter(points: Points = None) -> None:
    """Load the machine code of `run`; without one it is compiled.

    Args:
        points: None for the EKF; which ones the UKF has does not matter.
    """
    h, now, par = History(0, 1), Now(), np.zeros(1, PARAMETERS)
    compile_for(run, plain(h.events), plain(h.states), 0, 0, par, points, 0, plain(now.states))


class NumbaFilter(FilterBackend):
    """The kernels of `hil.estimator.event_loop`; making the first one loads or compiles them.

    Args:
        par: see `hil.estimator.kernel_layout.parameters`.
        points: of the UKF; None for the EKF.
    """

    def __init__(self, par: Records, points: Points) -> None:
        load_filter(points)
        self._par, self._points = par, points

    def run(self, history: History, begin: int, zero_ns: int, now_ns: int, now: Now) -> None:
        """One call for the whole stretch."""
        events, states, newest = plain(history.events), plain(history.states), plain(now.states)
        run(events, states, begin, zero_ns, self._par, self._points, now_ns, newest)


class FusionEstimator(Estimator):
    """EKF or UKF over all sensors.

    Args:
        config, geometry, surface: see `hil.estimator.make_estimator`.
        engine: runs the events.
        diagnostics: whether states carry them.
    """

    def __init__(
        self,
        config: EstimatorConfig,
        geometry: WheelGeometry,
        surface: str,
        engine: FilterBackend,
        *,
        diagnostics: bool = True,
    ) -> None:
        self.config, self.geometry, self.surface = config, geometry, surface
        self.engine, self._diagnosed = engine, diagnostics
        self._intake = MeasurementQueue(config)
        self.history = History(nanoseconds(config.time.history_s))
        self._now = Now()
        self._now.figures[_GATE_ROW], self._now.figures[_GATE_POSE] = (
            config.gates.one_dof,
            config.gates.three_dof,
        )
        self._ready = False

    def reset(self, state: RobotState) -> None:
        """Start from a known state; its covariance is that of pose and twist.

        Raises:
            UsageError: the state is not finite or its covariance is not a covariance.
        """
        x, p = start_of(self.config, self.surface, state)
        self._zero_ns = state.t_ns
        self._intake.reset()
        self.history.reset(state.t_ns, x, p, first_memory())
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
        figures = self._diagnostics(measurements.t_ns) if self._diagnosed else {}
        return RobotState(
            measurements.t_ns, now.pose.copy(), now.twist.copy(), now.covariance.copy(), figures
        )

    def _diagnostics(self, t_ns: int) -> dict[str, float]:
        """Figures by name, in this order: what the sensors said, what was refused, ages."""
        intake, variance_of = self._intake, self._now.p.item
        values: list[float] = self._now.figures.take(_PLACES).tolist()
        values[_AT_SAG] = -values[_AT_SLIP_UP]
        values[_AT_SCALE_SIGMA] = math.sqrt(max(variance_of(SCALE, SCALE), 0.0))
        values[_AT_SAG_SIGMA] = math.sqrt(max(variance_of(SLIP_X, SLIP_X), 0.0))
        values += intake.refused.values()
        out = dict(zip(_NAMES, values, strict=True))
        _, _, late, duplicate = self.history.marks.tolist()
        out["rejected_late"] += late
        out["rejected_duplicate"] += duplicate
        if self.config.time.clock == "estimated":
            for name, clock in intake.clocks.items():
                out[f"clock_offset_{name}_s"], out[f"clock_drift_{name}"] = clock.offset_s, clock.drift
        for name, last_ns in intake.last_ns.items():
            out[_AGES[name]] = (t_ns - last_ns) / NS_PER_S
        return out
