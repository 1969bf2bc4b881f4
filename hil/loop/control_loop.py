"""The control loop: one cycle from devices to devices, and the deterministic part of it by itself.

`ControlPipeline.decide` is all that lies between reading and sending: a function of the inputs and its own
state, so a recording's inputs fed back through it reproduce the recorded setpoints exactly (`hil replay`).
`ControlLoop.run` adds the devices, the clock and the sinks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hil.core.clock import NS_PER_S, Clock
from hil.core.errors import DeviceTimeoutError, HilError, SafetyStop
from hil.core.external_commands import ExternalCommands
from hil.core.interfaces import Controller, Estimator, ExternalController, Sink
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
from hil.loop.checks.adhesion import LETTING_GO
from hil.loop.checks.loop_pause import HELD_UP_NS, stood_still
from hil.loop.cycle import NO_INFLATION, Cycle
from hil.loop.device_set import DeviceSet
from hil.loop.restart import Restart
from hil.loop.supervisor import Supervisor
from hil.loop.timing import Laps, LoopStatistics
from hil.loop.user_parts import asked, controlled, own_name, reset_estimator

__all__ = ["OUTSIDE", "ControlLoop", "ControlPipeline", "Decision", "LoopStatistics"]

OUTSIDE = "loop"
"""Source of the event in the last record of a run that was ended by something other than its pipeline."""

_OWN = ""
_SHAKEN_M_S, _SHAKEN_RAD_S = 0.05, 0.1
"""By how much speeds may be off that a lying device had told."""

ReferenceAt = Callable[[float], Reference]
Lap = Callable[[str], None]


@dataclass(frozen=True)
class Decision:
    """What the pipeline made of one cycle's inputs."""

    measurements: Measurements
    state: RobotState
    reference: Reference | None
    setpoint: WheelSetpoint
    command: ServoSetpoint
    events: tuple[Event, ...]
    observers: Mapping[str, RobotState]
    external: ExternalCommands | None = None


def _untimed(section: str) -> None:
    """Nothing measures how long the sections take."""


class ControlPipeline:
    """Supervisor, alignment, estimator and controller in their fixed order.

    Estimator, controller and observers may be of one's own: `hil.loop.user_parts` checks what they return.

    Args:
        reference_at: reference by seconds since the first cycle; None observes without moving.
        observers: further estimators that run on the same measurements; their states are recorded.
        restart: how it goes on after the loop stood still; None where the wheels go on meanwhile.
        external: another program that drives in place of `controller`; None without.

    Attributes:
        estimator, controller, observers: may be exchanged before a run.
        reference: of the latest cycle, also when that ended in a `SafetyStop`.
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
        self._t0_ns: int | None = None
        self._waited_ns = 0
        self._steering = np.zeros(4)
        self._states: dict[str, RobotState] = {}
        self._ask()

    def _ask(self) -> None:
        """Find out how each part is asked: those of one's own are checked."""
        self._estimate = asked(self.estimator)
        self._observe = {name: asked(observer) for name, observer in self.observers.items()}
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
        """Steps 2 to 7.

        Args:
            inputs: what the devices delivered.
            lap: told when `estimate` (2 to 4) and `control` (5 to 7) are done; decides nothing.

        Raises:
            SafetyStop: the robot must be held.
            UsageError: an estimator or a controller has returned something else than a state or setpoints.
        """
        self.reference = None
        if self.external is not None:
            self.external.heard = None
        run_s = self._run_s(inputs.t_ns)
        if self.restart is not None:
            self.restart.judge(inputs.t_ns)
        safety = self.supervisor
        cycle = safety.begin(inputs, self.alignment.measure(inputs))
        safety.check_samples(cycle)
        if cycle.inflation != NO_INFLATION:
            self._inflate(*cycle.inflation)
        believed = safety.left_out.believed(cycle.measurements)
        state = self._states[_OWN] = self._estimate(believed)
        cycle.state = state = _with_figures(state, cycle.diagnostics) if cycle.diagnostics else state
        cycle.observers = {name: observe(believed) for name, observe in self._observe.items()}
        self._states.update(cycle.observers)
        lap("estimate")
        if self.reference_at is not None:
            self.reference = self.reference_at(run_s)
        cycle.reference = self.reference
        safety.check_estimate(cycle)
        setpoint = safety.limit(self._control(cycle, state))
        command = self.alignment.to_servos(setpoint)
        lap("control")
        return Decision(
            cycle.measurements,
            state,
            cycle.reference,
            setpoint,
            command,
            tuple(cycle.events),
            cycle.observers,
            self.heard,
        )

    def _run_s(self, t_ns: int) -> float:
        """The reference's time: from the first cycle on, or from when another program has begun to drive."""
        t0_ns = t_ns if self._t0_ns is None else self._t0_ns
        if self.external is not None and not self.external.begun:
            self._waited_ns += t_ns - t0_ns
            t0_ns = t_ns
        self._t0_ns = t0_ns
        return (t_ns - t0_ns) / NS_PER_S

    def _inflate(self, off_m: float, off_rad: float) -> None:
        """Go on from the last states, which may be off by what a lying device had told.

        Args:
            off_m: along each axis.
            off_rad: of the heading.
        """
        more = np.array([off_m, off_m, off_rad, _SHAKEN_M_S, _SHAKEN_M_S, _SHAKEN_RAD_S])
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
                setpoint = controlled(self.controller, measurements.cycle, state, reference, wheels)
            else:
                setpoint = self.controller.update(state, reference, wheels)
        if setpoint is None:
            return WheelSetpoint(np.zeros(4), self._steering.copy())
        return setpoint if self.restart is None else self.restart.limit(setpoint, wheels)

    @property
    def commands(self) -> bool:
        """Whether it tells the servos anything."""
        return self.controller is not None or self.external is not None

    @property
    def heard(self) -> ExternalCommands | None:
        """What another program that drives sent in the latest cycle."""
        return None if self.external is None else self.external.heard

    @property
    def waited_ns(self) -> int:
        """By how much the reference is behind the clock: the loop stood still, or a program had not begun."""
        return self._waited_ns + (0 if self.restart is None else self.restart.waited_ns)

    def _complete(self, wheels: WheelMeasurement) -> WheelMeasurement:
        """Newest wheels; where a steering angle was not read, with the last one that was."""
        steering = wheels.steering_rad
        if not math.isfinite(sum(steering.tolist())):
            steering = np.where(np.isfinite(steering), steering, self._steering)
            wheels = replace(wheels, steering_rad=steering)
        self._steering = steering
        return wheels


def _before_control(cycle: Cycle, state: RobotState) -> CycleRecord:
    """A cycle as far as it has come when its command is asked for."""
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
    """The state with what the checks measured."""
    return RobotState(
        state.t_ns,
        state.pose_body_in_wall,
        state.twist_body,
        state.covariance,
        {**state.diagnostics, **figures},
    )


class ControlLoop:
    """Runs a pipeline on a rig at a fixed rate with absolute deadlines.

    A missed deadline is counted; deadlines that have passed entirely are skipped on the grid, never
    made up for in a burst. Whatever goes wrong, the actuators are stopped before the error leaves.

    Args:
        rig, clock, pipeline: devices, time, and what decides.
        rate_hz: cycles per second.
        late_after_s: a start later than this after its deadline counts as late.
        sinks: receive every cycle.
        truth: what an emulated robot really does, for the records only: nothing that decides sees it.

    Attributes:
        idle: called with the next deadline (ns) when a cycle is done; may use the time until then. None at
            first: a bench in real time sets it for its runs.
    """

    def __init__(
        self,
        rig: DeviceSet,
        clock: Clock,
        pipeline: ControlPipeline,
        *,
        rate_hz: float = 100.0,
        late_after_s: float = 0.001,
        sinks: tuple[Sink, ...] = (),
        truth: Callable[[], Mapping[str, Any] | None] = lambda: None,
    ) -> None:
        self.rig, self.clock, self.pipeline, self._truth = rig, clock, pipeline, truth
        self.period_ns = round(NS_PER_S / rate_hz)
        self.late_ns = round(late_after_s * NS_PER_S)
        self.sinks = sinks
        self.idle: Callable[[int], None] | None = None
        self.statistics = LoopStatistics()
        self._cycle = self._sinks_ns = 0
        self._began_ns: int | None = None

    def run(self, until: Callable[[CycleRecord], bool]) -> None:
        """Cycle until `until(record)` says so; always asks the robot to stop."""
        deadline_ns = self.clock.now_ns()
        self._began_ns = None
        try:
            while True:
                self.clock.sleep_until_ns(deadline_ns)  # 10
                self._heed_sinks()
                record = self.cycle(deadline_ns)
                if until(record):
                    return
                deadline_ns = self._next_deadline(deadline_ns)
                if self.idle is not None:
                    self.idle(deadline_ns)
                self._rest()
        finally:
            if self.rig.servos is not None:
                self.rig.servos.stop()
            self._rest()

    def cycle(self, deadline_ns: int) -> CycleRecord:
        """One pass through the loop; `timing_ns["sinks"]` of a record is the previous cycle's."""
        start_ns = self.clock.now_ns()
        laps = Laps(self.clock, start_ns)
        lap = laps.done
        inputs = self._read(start_ns)  # 1
        lap("read")
        try:
            decision = self.pipeline.decide(inputs, lap)  # 2 to 7
        except SafetyStop as stop:
            self._stopped(inputs, stop)
            raise
        if self.pipeline.commands and self.rig.servos is not None:
            self.rig.servos.command(decision.command)  # 8
        lap("write")
        timing = {**laps.timing_ns, "lateness": start_ns - deadline_ns, "sinks": self._sinks_ns}
        record = CycleRecord(
            self._cycle,
            deadline_ns,
            start_ns,
            inputs,
            decision.measurements,
            decision.state,
            decision.reference,
            decision.setpoint,
            decision.command,
            decision.events,
            decision.observers,
            timing,
            self._truth(),
            decision.external,
        )
        for sink in self.sinks:  # 9
            sink.write(record)
        lap("sinks")
        self._count(start_ns, deadline_ns, laps.timing_ns)
        return record

    def _read(self, start_ns: int) -> Inputs:
        """Drain every device; after a long pause a silent one is not blamed before the loop itself."""
        before_ns, self._began_ns = self._began_ns, start_ns
        try:
            return self.rig.read(self._cycle)
        except DeviceTimeoutError as error:
            gap_ns = 0 if before_ns is None else start_ns - before_ns
            if gap_ns <= HELD_UP_NS:
                raise
            stop = SafetyStop("held_up", f"{stood_still(gap_ns)}; then {error}")
            self._stopped(Inputs(self._cycle, start_ns), stop, source=OUTSIDE)
            raise stop from error

    def _rest(self) -> None:
        """Let sinks' threads have the interpreter now: beside a cycle they would make it longer."""
        for sink in self.sinks:
            sink.rest()

    def _heed_sinks(self) -> None:
        """Stop and raise when a sink objects to a further cycle."""
        for sink in self.sinks:
            error = sink.objection()
            if error is not None:
                self._stopped(Inputs(self._cycle, self.clock.now_ns()), error, source=OUTSIDE)
                raise error

    def _count(self, start_ns: int, deadline_ns: int, durations: Mapping[str, int]) -> None:
        lateness_ns = start_ns - deadline_ns
        self.statistics.cycles += 1
        self.statistics.late += lateness_ns > self.late_ns
        self.statistics.add({**durations, "work": sum(durations.values()), "lateness": lateness_ns})
        self._sinks_ns = durations["sinks"]
        self._cycle += 1

    def _next_deadline(self, deadline_ns: int) -> int:
        following = deadline_ns + self.period_ns
        behind_ns = self.clock.now_ns() - following
        if behind_ns > 0:
            self.statistics.overruns += 1
            missed = behind_ns // self.period_ns
            self.statistics.skipped += missed
            following += missed * self.period_ns
        return following

    def _stopped(self, inputs: Inputs, stop: HilError, *, source: str = "supervisor") -> None:
        """Hold the robot at once and leave a last record that names the reason."""
        if self.rig.servos is not None:
            self.rig.servos.stop()
        if isinstance(stop, SafetyStop) and stop.reason in LETTING_GO:
            self.rig.brace()
        event = Event(inputs.t_ns, "error", source, str(stop))
        zero = np.zeros(4)
        nothing = Measurements(inputs.cycle, inputs.t_ns, added=inputs.added)
        state = RobotState(inputs.t_ns, np.full(3, np.nan), np.full(3, np.nan), np.full((6, 6), np.nan))
        record = CycleRecord(
            self._cycle,
            inputs.t_ns,
            inputs.t_ns,
            inputs,
            nothing,
            state,
            self.pipeline.reference,
            WheelSetpoint(zero, zero),
            ServoSetpoint(zero, zero),
            (event,),
            external=self.pipeline.heard,
        )
        for sink in self.sinks:
            sink.write(record)
