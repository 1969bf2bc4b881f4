"""`FusionEstimator`: buffers a cycle's samples, rewinds to the oldest new one and replays the events.

A `FilterBackend` runs the events: the compiled kernels (`NumbaFilter`) or filterpy. The result is
deterministic: the order in which samples arrive does not change a bit of the state.
"""

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
from hil.estimator.kernel_layout import MEMORY, MEMORY_FLOATS, PARAMETERS, States, first_memory, next_memory
from hil.estimator.measurement_queue import REASONS, MeasurementQueue
from hil.estimator.sensors import SENSORS
from hil.estimator.sigma_points import Points
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
    """Newest state, covariance and sensor memory, at the time of the cycle.

    Attributes:
        figures: one array of memory, state, gates and derived values, from which the diagnostics are picked.
        x, p: state (20,) and covariance (20, 20); x is a view into `figures`.
        m: (1,) sensor memory, a view into `figures`.
        states: x, p and m together.
        pose, twist, covariance: newest estimate, (3,), (3,) and (6, 6): views into x and p.
    """

    def __init__(self) -> None:
        self.figures = np.zeros(_SAG_SIGMA + 1)
        self.m: Records = self.figures[:_STATE].view(MEMORY)
        self.x = self.figures[_STATE : _STATE + STATES]
        self.p = np.zeros((STATES, STATES))
        self.states = States(self.x, self.p, self.m)
        self.pose, self.twist, self.covariance = self.x[POSE], self.x[TWIST], self.p[:MOTION, :MOTION]


class FilterBackend(Protocol):
    """Engine that runs events through the filter."""

    @abstractmethod
    def run(self, history: History, begin: int, zero_ns: int, now_ns: int, now: Now) -> None:
        """Replay the events of a history from `begin` on; predict the last state to `now_ns` into `now`."""


@cache
def load_filter(points: Points = None) -> None:
    """Load the compiled code of `run`, or compile it where none is cached.

    Args:
        points: None for the EKF; for the UKF only the type matters, not the values.
    """
    h, now, par = History(0, 1), Now(), np.zeros(1, PARAMETERS)
    compile_for(run, plain(h.events), plain(h.states), 0, 0, par, points, 0, plain(now.states))


class NumbaFilter(FilterBackend):
    """Runs events through the kernels of `hil.estimator.event_loop`, compiled or loaded on first use.

    Args:
        par: parameters, see `hil.estimator.kernel_layout.parameters`.
        points: sigma points of the UKF; None for the EKF.
    """

    def __init__(self, par: Records, points: Points) -> None:
        load_filter(points)
        self._par, self._points = par, points

    def run(self, history: History, begin: int, zero_ns: int, now_ns: int, now: Now) -> None:
        """Replay all events in one call of the compiled kernel."""
        events, states, newest = plain(history.events), plain(history.states), plain(now.states)
        run(events, states, begin, zero_ns, self._par, self._points, now_ns, newest)


class FusionEstimator(Estimator):
    """EKF or UKF over all sensors, with a history to rewind to for late samples.

    Args:
        config, geometry, surface: arguments of the maker, see `hil.estimator.make_estimator`.
        engine: filter that runs the events.
        diagnostics: True if states contain diagnostics.
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
        self._latest_ns: int | None = None

    def reset(self, state: RobotState) -> None:
        """Start from a known state, whose covariance (6, 6) is that of pose and twist.

        A state of the time of the latest estimate goes on with it: the measured noise of the sensors is kept.

        Raises:
            UsageError: the state is not finite or its covariance is not a covariance.
        """
        x, p = start_of(self.config, self.surface, state)
        self._zero_ns = state.t_ns
        self._intake.reset()
        goes_on = state.t_ns == self._latest_ns
        self.history.reset(state.t_ns, x, p, next_memory(self._now.m) if goes_on else first_memory())
        self._ready, self._latest_ns = True, None

    def update(self, measurements: Measurements) -> RobotState:
        """Process one cycle's measurements and return the state at the cycle's time."""
        if not self._ready:
            covariance = np.diag([1e-6] * 3 + [_TWIST_SIGMA**2] * 3)
            start_ns = measurements.t_ns - self.history.span_ns
            self.reset(RobotState(start_ns, np.zeros(3), np.zeros(3), covariance))
        h, now = self.history, self._now
        begin = h.enter(self._intake.stage(measurements, h.base_ns), measurements.t_ns)
        self.engine.run(h, begin, self._zero_ns, measurements.t_ns, now)
        self._latest_ns = measurements.t_ns
        figures = self._diagnostics(measurements.t_ns) if self._diagnosed else {}
        return RobotState(
            measurements.t_ns, now.pose.copy(), now.twist.copy(), now.covariance.copy(), figures
        )

    def _diagnostics(self, t_ns: int) -> dict[str, float]:
        """Diagnostics by name, in this order: filter figures, refused samples, sensor clocks, ages in s."""
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
