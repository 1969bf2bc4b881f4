"""Real time on an ordinary kernel: scheduler, interpreter, collector, and code loaded beforehand.

`with RealTime(clock, fifo_priority=..., cpu=...) as real_time:` holds around the loop, as often as one
likes; the loop calls `real_time.idle(deadline_ns)` when a cycle is done. Whatever the system refuses is
a warning that says what to do, never an error: the loop also runs without.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import sys
from collections.abc import Callable
from types import TracebackType

import numpy as np

from hil.core.clock import NS_PER_S, Clock, nanoseconds, sleep_punctually
from hil.core.errors import SafetyStop, reason_of
from hil.core.signals import (
    ImuSample,
    Inputs,
    MocapSample,
    RobotState,
    ServoSample,
    Stamp,
    Status,
    TrackerSample,
)
from hil.loop.pipeline import ControlPipeline
from hil.loop.timing import LoopStatistics
from hil.robot.statics import GRAVITY_M_S2

LOG = logging.getLogger(__name__)

_NICE = -5
_SWITCH_INTERVAL_S = 0.0002
_YOUNG_EVERY_NS = nanoseconds(1.0)
_ALL_EVERY_NS = nanoseconds(20.0)
_YOUNG_SLACK_NS = nanoseconds(0.002)
_ALL_SLACK_NS = nanoseconds(0.001)
_PER_OBJECT_NS = 1500
_PERIOD_NS = nanoseconds(0.01)
_WARM_UP_CYCLES = 5


class RealTime:
    """Scheduling and garbage collection of the calling thread while the context is open.

    Memory that exists at the start is taken out of the collector's sight; from then on it collects
    only in time that a cycle has left. A sink that keeps every record makes a full collection longer than any
    cycle: it is expected to take as long as the last one and 1.5 us (measured) for each object that has
    come since, and is left out where that does not fit. The interpreter hands its lock over more often, so
    that a sink's thread delays a cycle by a fifth of a millisecond at a time.

    Args:
        clock: the loop's clock.
        fifo_priority: `SCHED_FIFO` priority 1..99; None leaves the scheduler alone.
        cpu: processor to stay on; None for any.

    Attributes:
        warnings: what was refused, and what to do about it.
        collections: how often the collector ran in idle time.
    """

    def __init__(self, clock: Clock, *, fifo_priority: int | None = None, cpu: int | None = None) -> None:
        self._clock, self._fifo_priority, self._cpu = clock, fifo_priority, cpu
        self._undo: list[Callable[[], None]] = []
        self._young_ns = self._all_ns = 0
        self._all_takes_ns = _ALL_SLACK_NS
        self.warnings: list[str] = []
        self.collections = 0

    def __enter__(self) -> RealTime:
        self._pin()
        sleep_punctually()
        self._undo.append(lambda: sleep_punctually(False))
        self._go_first()
        self._prioritise()
        before_s = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_INTERVAL_S)
        self._undo.append(lambda: sys.setswitchinterval(before_s))
        was_enabled = gc.isenabled()
        gc.collect()
        gc.freeze()
        gc.disable()
        self._undo += [gc.unfreeze, gc.enable if was_enabled else gc.disable]
        self._young_ns = self._all_ns = self._clock.now_ns()
        self._all_takes_ns = _ALL_SLACK_NS
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        while self._undo:
            self._undo.pop()()

    def idle(self, deadline_ns: int) -> None:
        """Collect garbage if that is due and fits into the time before the next cycle."""
        now_ns = self._clock.now_ns()
        slack_ns = deadline_ns - now_ns
        new_ns = _PER_OBJECT_NS * gc.get_count()[0]
        if now_ns - self._all_ns >= _ALL_EVERY_NS and slack_ns >= 2 * (self._all_takes_ns + new_ns):
            gc.collect()
            self._young_ns = self._all_ns = now_ns
            self._all_takes_ns = self._clock.now_ns() - now_ns
        elif now_ns - self._young_ns >= _YOUNG_EVERY_NS and slack_ns >= _YOUNG_SLACK_NS:
            self._all_takes_ns += new_ns
            gc.collect(1)
            self._young_ns = now_ns
        else:
            return
        self.collections += 1

    def _refused(self, warning: str) -> None:
        """Say it once, however often the context is entered."""
        if warning not in self.warnings:
            self.warnings.append(warning)
            LOG.warning("%s", warning)

    def _pin(self) -> None:
        if self._cpu is None:
            return
        before = os.sched_getaffinity(0)
        try:
            os.sched_setaffinity(0, {self._cpu})
        except OSError as error:
            self._refused(
                f"loop.cpu = {self._cpu} was refused ({reason_of(error)}); "
                f"this process may use {', '.join(map(str, sorted(before)))}"
            )
            return
        self._undo.append(lambda: os.sched_setaffinity(0, before))

    def _go_first(self) -> None:
        """Go before other programs where that is allowed; a refusal is no warning."""
        before = os.getpriority(os.PRIO_PROCESS, 0)
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, min(before, _NICE))
            self._undo.append(lambda: os.setpriority(os.PRIO_PROCESS, 0, before))

    def _prioritise(self) -> None:
        if self._fifo_priority is None:
            return
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        try:
            os.sched_setscheduler(
                0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(self._fifo_priority)
            )
        except OSError as error:
            self._refused(
                f"loop.fifo_priority = {self._fifo_priority} was refused ({reason_of(error)}); allow it with "
                f"`ulimit -r {self._fifo_priority}` or an rtprio line in /etc/security/limits.conf"
            )
            return
        self._undo.append(lambda: os.sched_setscheduler(0, policy, parameters))


def idle_loop(
    clock: Clock, real_time: RealTime, *, seconds: float, rate_hz: float, late_after_s: float = 0.001
) -> LoopStatistics:
    """Punctuality of a loop that sleeps until each deadline and does nothing: what the machine itself costs.

    Args:
        clock: the host's.
        real_time: scheduling as of the loop that is to be compared; held around this one.
        seconds: how long.
        rate_hz: cycles per second.
        late_after_s: a start later than this after its deadline counts as late.
    """
    statistics, period_ns, late_ns = LoopStatistics(), round(NS_PER_S / rate_hz), nanoseconds(late_after_s)
    with real_time:
        deadline_ns = clock.now_ns() + period_ns
        for _ in range(round(seconds * rate_hz)):
            clock.sleep_until_ns(deadline_ns)
            lateness_ns = clock.now_ns() - deadline_ns
            statistics.cycles += 1
            statistics.late += lateness_ns > late_ns
            statistics.add({"lateness": lateness_ns})
            deadline_ns += period_ns * (1 + max(0, lateness_ns // period_ns))
            real_time.idle(deadline_ns)
    return statistics


def warm_up(pipeline: ControlPipeline, start: RobotState) -> None:
    """Run a pipeline for a few cycles on made-up inputs at rest, so that all its code is compiled and loaded.

    Loading compiled estimators takes some tenths of a second: longer than servos may be left alone.

    Args:
        pipeline: reset to `start` before and after.
        start: where the robot stands, at or before the first cycle.
    """
    pipeline.reset(start)
    for k in range(1, _WARM_UP_CYCLES + 1):
        try:
            pipeline.decide(_at_rest(k, start))
        except SafetyStop as stop:
            LOG.debug("while warming up: %s", stop)
    pipeline.reset(start)


def _at_rest(cycle: int, start: RobotState) -> Inputs:
    t_ns = start.t_ns + cycle * _PERIOD_NS
    stamp, upright, still = Stamp(t_ns, t_ns, cycle), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    place = np.array([start.pose_body_in_wall[0], start.pose_body_in_wall[1], 0.0])
    servos = ServoSample(stamp, np.zeros(8), np.zeros(8), np.zeros(8), (Status.OK,) * 8)
    inertial = ImuSample(stamp, upright, still, still, np.array([GRAVITY_M_S2, 0.0, 0.0]), ())
    camera = TrackerSample(stamp, still, upright, still, still, 3)
    capture = MocapSample(stamp, place, upright, True, 0.0, 0.0)
    return Inputs(cycle, t_ns, (servos,), (), (), (inertial,), (camera,), (capture,))
