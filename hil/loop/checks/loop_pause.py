"""Checks whether the control loop itself paused: the program was stopped, or the computer was too busy.

During a pause the servos' watchdogs trip and buffers overflow: healthy devices look silent or jump. So a long
pause stops the robot with its own reason, and a shorter one is mentioned with the reason of a stop. Time that
the kernel says was lost (`Inputs.lost_ns`) counts for no device as silence.
"""

from collections import deque
from collections.abc import Collection, Mapping

from hil.core.clock import NS_PER_S
from hil.core.interfaces import ReportStop
from hil.core.signals import Event, Inputs
from hil.loop.cycle_data import SILENT, Check, Cycle
from hil.support.lost_time import LOOP, late_in_words

HELD_UP, HELD_UP_NS = "held_up", 500_000_000
"""Reason of a stop because the loop, or what serves emulated devices, was late; longest healthy pause, ns."""
_HOLDS_UP_NS = 20_000_000
"""Time of one device's read that is reported."""
_PAUSE_NS, _PAUSE_CYCLES, _FRESH_NS = 60_000_000, 3, 1_000_000_000
"""Pauses mentioned in a stop: least duration (ns) and cycles, and longest time since their end (ns)."""


def stood_still(gap_ns: int) -> str:
    """Message that no cycle began for a time, with the remedy."""
    return (
        f"the control loop stood still for {gap_ns / NS_PER_S:.1f} s: this program was stopped, or "
        "the computer had no time for it. Look for what else ran, then start the motion again"
    )


class LoopPause(Check):
    """Checks the cycle times of one run.

    Args:
        emulated: emulated devices. In real time another process serves them, which may be late itself.
        served: devices of which this bench only knows that a program of this computer serves them.
    """

    def __init__(self, emulated: Collection[str] = (), served: Collection[str] = ()) -> None:
        self._emulated, self._served_here = frozenset(emulated), frozenset((*emulated, *served))
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self._last_ns: int | None = None
        self._cycle_ns = self._ended_ns = self._lasted_ns = 0
        self._reported_ns: dict[str, int] = {}
        self._lost_ns = self._lost_served_ns = self._late_ns = 0
        self._recent: deque[tuple[int, int]] = deque()

    def lost_ns(self, name: str) -> int:
        """Time since the previous cycle that this computer took from the exchange with a device, ns."""
        return self._lost_served_ns if name in self._served_here else self._lost_ns

    def ended_at(self, t_ns: int) -> int:
        """Length (ns) of the pause that ended with the cycle at `t_ns`; 0 without one."""
        return self._lasted_ns if t_ns == self._ended_ns else 0

    def on_samples(self, cycle: Cycle) -> None:
        """Check the time of the cycle, and report devices that hold up the loop."""
        self._count_lost(cycle.inputs)
        self.judge(cycle.inputs.t_ns, cycle.stop)
        for device, took_ns in cycle.inputs.slow_ns.items():
            self._report(device, took_ns, cycle)

    def _count_lost(self, inputs: Inputs) -> None:
        """Take what was lost since the previous cycle, at most its length; sum it over a second."""
        t_ns, lost = inputs.t_ns, inputs.lost_ns
        gap_ns = 0 if self._last_ns is None else t_ns - self._last_ns
        self._lost_ns = min(lost.get(LOOP, 0), gap_ns)
        self._lost_served_ns = min(sum(lost.values()), gap_ns)
        if self._lost_served_ns:
            self._recent.append((t_ns, self._lost_served_ns))
            self._late_ns += self._lost_served_ns
        while self._recent and t_ns - self._recent[0][0] > _FRESH_NS:
            self._late_ns -= self._recent.popleft()[1]

    def _report(self, device: str, took_ns: int, cycle: Cycle) -> None:
        """Report a device that took too long to be read, at most once a second."""
        t_ns = cycle.inputs.t_ns
        if took_ns > _HOLDS_UP_NS and t_ns - self._reported_ns.get(device, -_FRESH_NS) >= _FRESH_NS:
            self._reported_ns[device] = t_ns
            said = f"has held up the control loop for {1e-6 * took_ns:.0f} ms"
            cycle.events.append(Event(t_ns, "warning", device, said))

    def judge(self, t_ns: int, stop: ReportStop) -> None:
        """Check the time of a cycle.

        Args:
            t_ns: time of the cycle.
            stop: called after a long pause: the robot's motion in it is unknown, and its servos' watchdogs
                have stopped it.
        """
        before_ns, self._last_ns = self._last_ns, t_ns
        if before_ns is None:
            return
        gap_ns = t_ns - before_ns
        if gap_ns > HELD_UP_NS:
            self._lasted_ns = 0  # has its own reason
            stop(HELD_UP, stood_still(gap_ns))
        elif self._cycle_ns and gap_ns > _PAUSE_NS and gap_ns > _PAUSE_CYCLES * self._cycle_ns:
            self._ended_ns, self._lasted_ns = t_ns, gap_ns
        if gap_ns < self._cycle_ns or not self._cycle_ns:
            self._cycle_ns = gap_ns

    def beside(self, t_ns: int) -> str:
        """Text on a recent pause, for a stop with another reason; empty without a pause."""
        if not self._lasted_ns or t_ns - self._ended_ns > _FRESH_NS:
            late = self._late_in_words()
            return f"; {late}" if late else ""
        return (
            f"; the control loop had stood still for {self._lasted_ns / NS_PER_S:.2f} s just before. Where "
            "no device held it up, look first for what else ran on this computer: it makes healthy devices "
            "look silent"
        )

    def excuse(self, device: str) -> str:
        """Text: by how much this computer was late, where a silent device is emulated; else empty."""
        return self._late_in_words() if device in self._emulated else ""

    def excused(self, stops: Mapping[str, str]) -> dict[str, str]:
        """Messages of stop conditions by reason; those of excused devices become `held_up`.

        The devices are named first: one that has failed is silent whether or not the computer is late.
        """
        silent = {reason: reason.partition("_")[2] for reason in stops if reason.startswith(SILENT)}
        excused = {reason: name for reason, name in silent.items() if self.excuse(name)}
        late, names = next(map(self.excuse, excused.values()), ""), ", ".join(excused.values())
        found: dict[str, str] = {}
        for reason, said in stops.items():
            if reason not in excused:
                found[reason] = said
            else:
                said = f"nothing that can be used came in time from: {names}. Meanwhile {late}"
                found.setdefault(HELD_UP, said)
        return found

    def _late_in_words(self) -> str:
        late = late_in_words(
            self._late_ns, "the control loop, or from the emulated devices", " in the last second"
        )
        return f"{late}; end them" if late else ""
