"""The control loop: one cycle from devices to devices, at a fixed rate.

`ControlLoop.run` connects the pipeline (`hil.loop.pipeline`) with devices, clock and sinks. The steps of a
cycle, as numbered in both modules:

1. read all devices (`DeviceSet.read`);
2. align their samples (`Alignment.measure`);
3. check them (`Supervisor.check_samples`);
4. estimate the state (`Estimator.update`), also by observers;
5. get the reference, and check the estimate (`Supervisor.check_estimate`);
6. control (`Controller.update`) within limits (`Supervisor.limit`);
7. convert the setpoint to servo goals (`Alignment.to_servos`);
8. send them (`Actuators.command`);
9. pass the record to the sinks (`Sink.write`);
10. sleep until the next deadline.
"""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any

import numpy as np

from hil.core.clock import NS_PER_S, Clock
from hil.core.errors import DeviceTimeoutError, HilError, SafetyStop
from hil.core.interfaces import Sink
from hil.core.signals import (
    CycleRecord,
    Event,
    Inputs,
    Measurements,
    RobotState,
    ServoSetpoint,
    WheelSetpoint,
)
from hil.loop.checks.adhesion import presses_harder
from hil.loop.checks.loop_pause import HELD_UP, HELD_UP_NS, stood_still
from hil.loop.device_set import DeviceSet
from hil.loop.pipeline import OUTSIDE, ControlPipeline
from hil.loop.timing import Laps, LoopStatistics


class ControlLoop:
    """Runs a pipeline on a devices at a fixed rate with absolute deadlines.

    A missed deadline is counted; deadlines that have passed entirely are skipped, never made up for in a
    burst. On any error the actuators are stopped before the error is raised.

    Args:
        devices, clock, pipeline: devices, clock, and the pipeline that computes the commands.
        rate_hz: cycles per second.
        late_after_s: delay beyond its deadline from which on the start of a cycle counts as late.
        sinks: sinks that receive every cycle.
        truth: true state of an emulated robot, for the records only; it is not used for control.
        undivided: function that makes the context in which devices are read and commanded, records are
            written, and the clock sleeps. In that of a procedure, a signal of the user waits for the end of
            the block: it divides no exchange with a device and no action of an emulated one.

    Attributes:
        idle: called with the next deadline (ns) when a cycle is done; may use the time until then. None at
            first: a bench in real time sets it for its runs.
    """

    def __init__(
        self,
        devices: DeviceSet,
        clock: Clock,
        pipeline: ControlPipeline,
        *,
        rate_hz: float = 100.0,
        late_after_s: float = 0.001,
        sinks: tuple[Sink, ...] = (),
        truth: Callable[[], Mapping[str, Any] | None] = lambda: None,
        undivided: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self.devices, self.clock, self.pipeline, self._truth = devices, clock, pipeline, truth
        self.period_ns = round(NS_PER_S / rate_hz)
        self.late_ns = round(late_after_s * NS_PER_S)
        self.sinks = sinks
        self._undivided = undivided
        self.idle: Callable[[int], None] | None = None
        self.statistics = LoopStatistics()
        self._cycle = self._sinks_ns = 0
        self._began_ns: int | None = None

    def run(self, until: Callable[[CycleRecord], bool]) -> None:
        """Run cycles until `until(record)` is true; always stops the robot at the end."""
        deadline_ns = self.clock.now_ns()
        self._began_ns = None
        try:
            while True:
                with self._undivided():
                    self.clock.sleep_until_ns(deadline_ns)  # 10
                self._heed_sinks()
                record = self.cycle(deadline_ns)
                if until(record):
                    return
                deadline_ns = self._next_deadline(deadline_ns)
                if self.idle is not None:
                    self.idle(deadline_ns)
                self._rest()
        except BaseException:
            self.devices.disarm()
            raise
        finally:
            with self._undivided():
                if self.devices.servos is not None:
                    self.devices.servos.stop()
                self._rest()

    def cycle(self, deadline_ns: int) -> CycleRecord:
        """Run one cycle; `timing_ns["sinks"]` of its record is that of the previous cycle."""
        start_ns = self.clock.now_ns()
        laps = Laps(self.clock, start_ns)
        lap = laps.done
        with self._undivided():
            inputs = self._read(start_ns)  # 1
        lap("read")
        try:
            decision = self.pipeline.decide(inputs, lap)  # 2 to 7
        except SafetyStop as stop:
            self._stopped(inputs, stop)
            raise
        with self._undivided():
            if self.pipeline.commands and self.devices.servos is not None:
                self.devices.servos.command(decision.command)  # 8
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
        """Read every device; a timeout that is this computer's is reported as `held_up`."""
        before_ns, self._began_ns = self._began_ns, start_ns
        try:
            return self.devices.read(self._cycle)
        except DeviceTimeoutError as error:
            gap_ns = 0 if before_ns is None else start_ns - before_ns
            late = self.pipeline.supervisor.excuse(error.device)
            if gap_ns > HELD_UP_NS:
                why = f"{stood_still(gap_ns)}; then {error}"
            elif late:
                why = f"{error}. Meanwhile {late}"
            else:
                raise
            stop = SafetyStop(HELD_UP, why)
            self._stopped(Inputs(self._cycle, start_ns), stop, source=OUTSIDE)
            raise stop from error

    def _rest(self) -> None:
        """Let threads of sinks run now; during a cycle they would delay it."""
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
        """Stop the robot at once and write a last record with the reason and the checks' figures."""
        self.devices.disarm()
        with self._undivided():
            if self.devices.servos is not None:
                self.devices.servos.stop()
            supervisor = self.pipeline.supervisor
            if isinstance(stop, SafetyStop) and presses_harder(stop.reason, supervisor.checks.hold):
                self.devices.brace()
            events = [Event(inputs.t_ns, "error", source, str(stop))]
            if supervisor.slide is not None and supervisor.slide.push is not None:
                refused = self.devices.push(supervisor.slide.push, falls=supervisor.fall.falls)
                message = f"the propellers are not raised: {refused}"
                events += [Event(inputs.t_ns, "warning", "thrust", message)] * bool(refused)
            zero = np.zeros(4)
            nothing = Measurements(inputs.cycle, inputs.t_ns, added=inputs.added)
            figures = {} if source == OUTSIDE else dict(self.pipeline.figures)
            state = RobotState(
                inputs.t_ns, np.full(3, np.nan), np.full(3, np.nan), np.full((6, 6), np.nan), figures
            )
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
                tuple(events),
                external=self.pipeline.heard,
            )
            for sink in self.sinks:
                self.devices.aside.call(type(sink).__name__, partial(sink.write, record))
