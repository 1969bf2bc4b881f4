"""Finds servos that answer late, by reading them one by one after a stop.

One late answer delays all answers behind it, so that every servo times out and the cause cannot be seen.
Bytes that arrive while no answer is awaited reveal it. The control cycle has no time to find out which servo
sent them; while the robot rests there is time.
"""

import logging
import math
from collections.abc import Callable

from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.core.signals import SERVOS, Status
from hil.drivers.servos.dynamixel.bus import Bus, Exchange
from hil.drivers.servos.dynamixel.packets import GroupRead

_LOG = logging.getLogger(__name__)
_QUIET_S, _SETTLES_NS, _MOST_BYTES = 0.02, nanoseconds(0.3), 4096
_WHOLE_NS = nanoseconds(0.4)
"""A probe pauses after so long, and goes on there next time: a servo that restarts waits for its torque."""
_LONGEST_S = 0.25
"""A servo that takes longer than that to answer counts as dead."""
_SPARE, _EDGE_S, _ATTEMPTS = 1.5, 0.001, 3
"""A servo that is read alone counts as late after so many late answers: the host may be busy."""
_PAUSE_NS = nanoseconds(1.0)
"""Time between two probes, in which the servos are polled as usual."""


class LatencyProbe:
    """Finds the servos that answer late, and remembers them.

    Args:
        bus: open bus.
        ids: IDs of the servos.
        clock: the bench clock.
        watchdog_s: time of the servos' watchdog: no answer is awaited until it trips; 0 without one.

    Attributes:
        late_s: answer time of each late servo, s, by joint.
    """

    def __init__(self, bus: Bus, ids: tuple[int, ...], clock: Clock, *, watchdog_s: float) -> None:
        self._longest_s = watchdog_s or _LONGEST_S
        self._bus, self._ids, self._clock = bus, ids, clock
        self._next_ns, self._order = clock.now_ns(), list(range(len(ids)))
        self.late_s: dict[int, float] = {}

    def is_due(self) -> bool:
        """Whether unexpected bytes have come, or a servo must be read alone; not soon after a probe."""
        if self._clock.now_ns() < self._next_ns:
            return False
        return any(map(self.is_too_late, self.late_s)) or bool(self._bus.unasked())

    def is_too_late(self, joint: int) -> bool:
        """Whether a servo is too late to be waited for in `CycleReader.look`."""
        return _SPARE * self.late_s.get(joint, 0.0) > self._longest_s

    def probe_all(self, request: Callable[[int], tuple[GroupRead, float]]) -> tuple[int, ...]:
        """Read the eight servos, each alone; returns the joints of those found late.

        Args:
            request: function from a joint to its group read, and the longest time of an answer in time, s.
        """
        began_ns = self._clock.now_ns()
        while self._bus.gather(_QUIET_S, _MOST_BYTES) and self._clock.now_ns() - began_ns < _SETTLES_NS:
            pass
        for joint in tuple(self._order):
            if self._clock.now_ns() - began_ns > _WHOLE_NS:
                break
            self._order.append(self._order.pop(0))
            group, in_time_s = request(joint)
            for _ in range(_ATTEMPTS):
                took_s = _took_s(group, self._bus.exchange(group, _LONGEST_S))
                if not in_time_s + _EDGE_S < took_s < math.inf:
                    break
            self._judge(joint, took_s, in_time_s)
        self._next_ns = self._clock.now_ns() + _PAUSE_NS
        return tuple(self.late_s)

    def _judge(self, joint: int, took_s: float, in_time_s: float) -> None:
        """Record the answer time of a servo that was read alone."""
        name, before = f"{SERVOS[joint]} (ID {self._ids[joint]})", self.late_s.pop(joint, None)
        if in_time_s + _EDGE_S < took_s < math.inf:
            self.late_s[joint] = took_s
        if joint in self.late_s and before is None:
            _LOG.warning(
                "%s: %s answers after %.0f ms, at most %.0f ms are expected: it holds up the others",
                self._bus.device,
                name,
                1e3 * took_s,
                1e3 * in_time_s,
            )
        elif before is not None and joint not in self.late_s:
            again = "answers in time again" if took_s < math.inf else "does not answer any more"
            _LOG.warning("%s: %s %s", self._bus.device, name, again)

    def ask(self, joint: int, group: GroupRead, in_time_s: float, *, patient: bool) -> Exchange:
        """Read one servo alone.

        Args:
            joint: index.
            group: the read of this servo.
            in_time_s: longest time of an answer in time.
            patient: True if there is time to wait for a late one.
        """
        wait_s = _SPARE * self.late_s.get(joint, 0.0) if patient else 0.0
        exchange = self._bus.exchange(group, max(wait_s, in_time_s))
        if patient and joint in self.late_s:
            self._judge(joint, _took_s(group, exchange), in_time_s)
        return exchange

    def in_words(self) -> dict[str, str]:
        """Messages on the late servos, by name."""
        return {
            SERVOS[j]: f"ID {self._ids[j]}: answers after {1e3 * late_s:.0f} ms, which holds up the others: "
            "check its return delay time, its cable and its supply"
            for j, late_s in self.late_s.items()
        }


def _took_s(group: GroupRead, exchange: Exchange) -> float:
    """How long the one servo of a group has taken to answer; infinity where it has not."""
    (answer,) = group.answers(exchange.data).values()
    took_s = (exchange.received_ns - exchange.sent_ns) / NS_PER_S
    return took_s if answer.status is Status.OK else math.inf
