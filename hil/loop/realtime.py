"""Real time on a standard kernel: scheduler, interpreter, garbage collector, and code loaded in advance.

`with RealTime(clock, fifo_priority=..., cpu=...) as real_time:` encloses the loop and may be entered
repeatedly; the loop calls `real_time.idle(deadline_ns)` when a cycle is done. A setting that the system
refuses gives a warning with a remedy, never an error: the loop also runs without it.
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
    SERVOS,
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

    Objects that exist at the start are excluded from garbage collection; from then on the collector runs only
    in the idle time of a cycle. With a sink that keeps every record, a full collection takes longer than a
    cycle: its expected duration is that of the last one plus 1.5 us (measured) for each new object, and it is
    skipped if that does not fit. The interpreter releases its lock more often, so that a sink's thread delays
    a cycle by at most a fifth of a millisecond at a time.

    Args:
        clock: the loop's clock.
        fifo_priority: `SCHED_FIFO` priority 1..99; None leaves the scheduler alone.
        cpu: CPU to pin the thread to; None for any.

    Attributes:
        warnings: refused settings, and remedies.
        collections: number of collections in idle time.
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
            try:
                self._undo.pop()()
            except OSError as error:  # the others are undone all the same
                LOG.warning("a setting of the scheduler could not be put back (%s)", reason_of(error))

    def idle(self, deadline_ns: int) -> None:
        """Collect garbage if it is due and fits into the time before the next cycle."""
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
        """Add a warning once, even if the context is entered repeatedly."""
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
        """Raise the priority above that of other programs if permitted; a refusal gives no warning."""
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
        self._undo.append(lambda: _schedule_again(policy, parameters))


def _schedule_again(policy: int, parameters: os.sched_param) -> None:
    """Schedule this thread as before; where only root may clear `SCHED_RESET_ON_FORK`, that stays set.

    It then only keeps children of this thread from a priority that the thread no longer has (sched(7)).
    """
    try:
        os.sched_setscheduler(0, policy, parameters)
    except PermissionError:
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, parameters)


def idle_loop(
    clock: Clock, real_time: RealTime, *, seconds: float, rate_hz: float, late_after_s: float = 0.001
) -> LoopStatistics:
    """Timing statistics of a loop that only sleeps until each deadline: the jitter of the computer itself.

    Args:
        clock: the host's clock.
        real_time: scheduling of the loop to compare with; entered around this loop.
        seconds: duration, s.
        rate_hz: cycles per second.
        late_after_s: delay beyond its deadline from which on the start of a cycle counts as late.
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

    Loading compiled estimators takes some tenths of a second: longer than servos may be without commands.

    Args:
        pipeline: pipeline to run; it is reset to `start` before and after.
        start: state of the robot at rest, at or before the first cycle.
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
    servos = ServoSample(
        stamp, np.zeros(len(SERVOS)), np.zeros(len(SERVOS)), np.zeros(len(SERVOS)), (Status.OK,) * len(SERVOS)
    )
    inertial = ImuSample(stamp, upright, still, still, np.array([GRAVITY_M_S2, 0.0, 0.0]), ())
    camera = TrackerSample(stamp, still, upright, still, still, 3)
    capture = MocapSample(stamp, place, upright, True, 0.0, 0.0)
    return Inputs(cycle, t_ns, (servos,), (), (), (inertial,), (camera,), (capture,))
