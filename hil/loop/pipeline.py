"""The deterministic part of a cycle: all steps between reading and sending.

`ControlPipeline.decide` is a function of the inputs and its own state, so a recording's inputs fed back
through it reproduce the recorded setpoints exactly (`hil replay`).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from hil.core.clock import NS_PER_S
from hil.core.external_commands import ExternalCommands
from hil.core.interfaces import Controller, Estimator, ExternalController
from hil.core.signals import (
    CycleRecord,
    Event,
    Inputs,
    Measurements,
    Reference,
    RobotState,
    ServoSetpoint,
    WheelMeasurement,
    WheelSetpoint,
)
from hil.loop.alignment import Alignment
from hil.loop.cycle_data import NO_INFLATION, Cycle
from hil.loop.resume_motion import Restart
from hil.loop.supervisor import Supervisor
from hil.user_code.checked_calls import call_controller, checked_update, own_name, reset_estimator

OUTSIDE = "loop"
"""Source of the event in the last record of a run that was ended by something other than its pipeline."""

_OWN = ""
_DOUBTED_M_S, _DOUBTED_RAD_S = 0.05, 0.1
"""Largest error of speeds from a device with wrong values, m/s and rad/s."""

ReferenceAt = Callable[[float], Reference]
Lap = Callable[[str], None]


@dataclass(frozen=True)
class Decision:
    """Result of the pipeline for one cycle; `measurements` are those that are believed."""

    measurements: Measurements
    state: RobotState
    reference: Reference | None
    setpoint: WheelSetpoint
    command: ServoSetpoint
    events: tuple[Event, ...]
    observers: Mapping[str, RobotState]
    external: ExternalCommands | None = None


def _untimed(section: str) -> None:
    """A timer that does not measure the sections."""


class ControlPipeline:
    """Supervisor, alignment, estimator and controller in their fixed order.

    Estimator, controller and observers may be the user's: `hil.user_code.checked_calls` checks their results.

    Args:
        reference_at: reference by seconds since the first cycle; None observes without moving.
        observers: further estimators that run on the same measurements; their states are recorded.
        restart: object that resumes the motion after a pause of the loop; None where the wheels keep turning
            meanwhile.
        external: another program that drives in place of `controller`; None without one.

    Attributes:
        estimator, controller, observers: parts that may be replaced before a run.
        reference: reference of the latest cycle, also when that ended in a `SafetyStop`.
        figures: figures of the checks in that cycle (`Cycle.diagnostics`), by name.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        alignment: Alignment,
        estimator: Estimator,
        controller: Controller | None = None,
        reference_at: ReferenceAt | None = None,
        observers: Mapping[str, Estimator] | None = None,
        restart: Restart | None = None,
        external: ExternalController | None = None,
    ) -> None:
        self.external = external
        self.supervisor, self.alignment, self.restart = supervisor, alignment, restart
        self.estimator, self.controller = estimator, controller
        self.reference_at = reference_at
        self.observers = dict(observers or {})
        self.reference: Reference | None = None
        self.figures: Mapping[str, float] = {}
        self._t0_ns: int | None = None
        self._waited_ns = 0
        self._steering = np.zeros(4)
        self._states: dict[str, RobotState] = {}
        self._ask()

    def _ask(self) -> None:
        """Bind the update function of each part; results of user-supplied parts are checked."""
        self._estimate = checked_update(self.estimator)
        self._observe = {name: checked_update(observer) for name, observer in self.observers.items()}
        self.supervisor.observers.checked = tuple(n for n, one in self.observers.items() if own_name(one))
        self._checks_controller = bool(own_name(self.controller))

    def reset(self, state: RobotState) -> None:
        """Start a run from a known state; the reference's time starts with the next cycle."""
        self._t0_ns, self._waited_ns = None, 0
        self._steering = np.zeros(4)
        self._states = dict.fromkeys((_OWN, *self.observers), state)
        self.supervisor.reset()
        self.alignment.reset()
        if self.restart is not None:
            self.restart.reset()
        for estimator in (self.estimator, *self.observers.values()):
            reset_estimator(estimator, state)
        if self.controller is not None:
            self.controller.reset()
        if self.external is not None:
            self.external.reset()
        self._ask()

    def decide(self, inputs: Inputs, lap: Lap = _untimed) -> Decision:
        """Steps 2 to 7 of a cycle, as `hil.loop.control_loop` counts them.

        Args:
            inputs: samples of all devices.
            lap: called when `estimate` (2 to 4) and `control` (5 to 7) are done, to measure durations.

        Raises:
            SafetyStop: the robot must be held.
            UsageError: an estimator returned no state, or a controller no setpoints.
        """
        self.reference, self.figures = None, {}
        if self.external is not None:
            self.external.heard = None
        run_s = self._run_s(inputs.t_ns)
        if self.restart is not None:
            self.restart.judge(inputs.t_ns)
        safety = self.supervisor
        cycle = safety.begin(inputs, self.alignment.measure(inputs))  # 2
        self.figures = cycle.diagnostics
        safety.check_samples(cycle)  # 3
        if cycle.inflation != NO_INFLATION:
            self._inflate(*cycle.inflation)
        believed = safety.left_out.without_excluded(cycle.measurements)
        state = self._states[_OWN] = self._estimate(believed)  # 4
        cycle.state = state = _with_figures(state, cycle.diagnostics) if cycle.diagnostics else state
        cycle.observers = {name: observe(believed) for name, observe in self._observe.items()}
        self._states.update(cycle.observers)
        lap("estimate")
        if self.reference_at is not None:
            self.reference = self.reference_at(run_s)  # 5
        cycle.reference = self.reference
        safety.check_estimate(cycle)
        setpoint = safety.limit(self._control(cycle, state))  # 6
        command = self.alignment.to_servos(setpoint)  # 7
        lap("control")
        return Decision(
            believed,
            state,
            cycle.reference,
            setpoint,
            command,
            tuple(cycle.events),
            cycle.observers,
            self.heard,
        )

    def _run_s(self, t_ns: int) -> float:
        """Time of the reference, s: since the first cycle, or since another program began to drive."""
        t0_ns = t_ns if self._t0_ns is None else self._t0_ns
        if self.external is not None and not self.external.begun:
            self._waited_ns += t_ns - t0_ns
            t0_ns = t_ns
        self._t0_ns = t0_ns
        return (t_ns - t0_ns) / NS_PER_S

    def _inflate(self, off_m: float, off_rad: float) -> None:
        """Increase the covariance of the last states by the possible effect of a device with wrong values.

        Args:
            off_m: largest error along each axis, m.
            off_rad: largest error of the heading, rad.
        """
        more = np.array([off_m, off_m, off_rad, _DOUBTED_M_S, _DOUBTED_M_S, _DOUBTED_RAD_S])
        for name, estimator in {_OWN: self.estimator, **self.observers}.items():
            last = self._states[name]
            unsure = replace(last, covariance=last.covariance + np.diag(more**2), diagnostics={})
            reset_estimator(estimator, unsure)

    def _control(self, cycle: Cycle, state: RobotState) -> WheelSetpoint:
        measurements, reference = cycle.measurements, cycle.reference
        wheels = self._complete(measurements.wheels[-1]) if measurements.wheels else None
        setpoint = None
        if self.external is not None:
            known = self.external.warning
            setpoint = self.external.update(_before_control(cycle, state), wheels)
            if self.external.warning != known:
                cycle.events.append(Event(cycle.inputs.t_ns, "warning", OUTSIDE, self.external.warning))
        elif self.controller is not None and reference is not None and wheels is not None:
            if self._checks_controller:
                setpoint = call_controller(self.controller, measurements.cycle, state, reference, wheels)
            else:
                setpoint = self.controller.update(state, reference, wheels)
        if setpoint is None:
            return WheelSetpoint(np.zeros(4), self._steering.copy())
        return setpoint if self.restart is None else self.restart.limit(setpoint, wheels)

    @property
    def commands(self) -> bool:
        """Whether the loop commands the servos."""
        return self.controller is not None or self.external is not None

    @property
    def heard(self) -> ExternalCommands | None:
        """Commands of an external program in the latest cycle; None without one."""
        return None if self.external is None else self.external.heard

    @property
    def waited_ns(self) -> int:
        """Delay of the reference, ns: because the loop paused, or a program had not begun."""
        return self._waited_ns + (0 if self.restart is None else self.restart.waited_ns)

    def _complete(self, wheels: WheelMeasurement) -> WheelMeasurement:
        """Newest wheel measurement; missing steering angles are replaced by the last ones read."""
        steering = wheels.steering_rad
        if not math.isfinite(sum(steering.tolist())):
            steering = np.where(np.isfinite(steering), steering, self._steering)
            wheels = replace(wheels, steering_rad=steering)
        self._steering = steering
        return wheels


def _before_control(cycle: Cycle, state: RobotState) -> CycleRecord:
    """Record of a cycle before its command is computed; setpoint and command are zero."""
    t_ns, zero = cycle.inputs.t_ns, np.zeros(4)
    return CycleRecord(
        cycle.inputs.cycle,
        t_ns,
        t_ns,
        cycle.inputs,
        cycle.measurements,
        state,
        cycle.reference,
        WheelSetpoint(zero, zero),
        ServoSetpoint(zero, zero),
        tuple(cycle.events),
        cycle.observers,
    )


def _with_figures(state: RobotState, figures: Mapping[str, float]) -> RobotState:
    """The state with the figures of the checks added."""
    return RobotState(
        state.t_ns,
        state.pose_body_in_wall,
        state.twist_body,
        state.covariance,
        {**state.diagnostics, **figures},
    )
