"""Decides the set-point that is sent to a fan: a pure function of time, received reports and requests.

It never stops a fan by itself. A set-point stays until another is requested; it changes along a ramp; only
`end` leads down to rest. A duty is raised while the battery sags, so that the force stays (`VoltageTrim`). A
fan that runs already when the daemon starts is taken over as it runs. How it runs is what several reports
say: one may be damaged on the wire, and a robot may hang by the fan. The same class works in the daemon's
process, in a bench that replaces it, and in virtual time.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import DeviceError, UsageError, did_you_mean
from hil.fan_daemon.spec import Spec
from hil.fan_daemon.voltage_trim import VoltageTrim

_LISTEN_NS = nanoseconds(1.5)
"""Time after its start in which a daemon looks for a fan that runs already."""
_FRESH_NS = nanoseconds(1.0)
_REPORTS, _TOGETHER_NS = 5, nanoseconds(0.25)
"""Number of reports whose median counts, and their time span."""
_LIKE = 0.1
"""Share of the highest set-point by which two reports may differ of a fan that is taken over."""
_LONGEST_STEP_NS = nanoseconds(0.2)
_RELEASED_NS = nanoseconds(0.5)
_MOST_LISTED = 8


class SetPoint(NamedTuple):
    """A quantity and its value: `duty` (share), `current_a` (A), `erpm` (1/min as its controller counts)."""

    quantity: str
    value: float


RELEASE = SetPoint("current_a", 0.0)


def check_point(spec: Spec, point: SetPoint) -> None:
    """Raise `UsageError` for a quantity that this motor does not have, or a value out of its range."""
    highest = spec.highest.get(point.quantity)
    if highest is None:
        known = ", ".join(spec.highest)
        raise UsageError(
            f"{spec.device} set-point of {point.quantity}",
            expected=f"one of {known}",
            remedy=did_you_mean(point.quantity, spec.highest) or f"ask {spec.whose} daemon for one of these",
        )
    if not math.isfinite(point.value) or not 0.0 < point.value <= highest:
        raise UsageError(
            f"{spec.device} set-point {point.quantity} = {point.value:g}",
            expected=f"above 0, at most {highest:g}",
            remedy="`hil adhesion off` lets it come to rest",
        )


class FanControl:
    """Ramps one fan to the requested set-points and holds it there.

    Args:
        spec: the fan; limits and ramps.
        adopts: True to take over a fan that runs already at the start.

    Attributes:
        sent: the latest set-point for the bus; None while the fan is not commanded.
        target: the set-point at the end of the ramp.
        ending: True while the fan is on its way to rest.
        report: the fan's reports, by quantity; `report_ns` when it last reported its speed.
        others: ids of other controllers on the bus.
        trim: correction of a duty while the battery sags.
    """

    def __init__(self, spec: Spec, *, adopts: bool = True) -> None:
        self._spec, self._adopts = spec, adopts
        self.sent: SetPoint | None = None
        self.target: SetPoint | None = None
        self.ending = False
        self.report: dict[str, float] = {}
        self.report_ns: int | None = None
        self.others: set[int] = set()
        self.trim = VoltageTrim()
        self._recent: deque[tuple[int, Mapping[str, float]]] = deque(maxlen=_REPORTS)
        self._running: SetPoint | None = None
        self._theirs = False
        self._born_ns: int | None = None
        self._last_ns = 0
        self._released_ns = 0

    def reported(
        self, t_ns: int, controller_id: int, values: Mapping[str, float], running: SetPoint | None = None
    ) -> None:
        """Take a status report of a controller.

        Args:
            t_ns: time of the report.
            controller_id: the controller that sent it.
            values: figures by name; a report with `erpm` shows that it is present.
            running: the set-point that keeps it as it runs; None at rest.
        """
        if controller_id != self._spec.controller_id:
            self.others.add(controller_id)
            return
        self.report.update(values)
        if "erpm" in values:
            self.report_ns = t_ns
            self._recent.append((t_ns, values))
        sent, target = self.sent, self.target
        if sent is not None and target is not None and not self.ending and target.quantity == "duty":
            self.trim.take(t_ns, values, sent.value, target.value, self._spec.highest["duty"])
        if running is not None and self.sent is None:
            before, self._running = self._running, running
            if before is not None and self._like(before, running):
                self._take_over(t_ns, max(before, running))

    def _like(self, one: SetPoint, other: SetPoint) -> bool:
        """Whether two set-points are nearly the same; False where the spec does not have their quantity."""
        apart = _LIKE * self._spec.highest.get(one.quantity, 0.0)
        return one.quantity == other.quantity and abs(one.value - other.value) <= apart

    def observe_command(self, t_ns: int, order: SetPoint) -> None:
        """Take another program's set-point for this fan: it is exact, the fan's report is rounded.

        A fan that was taken over follows that program's set-points, down to rest as well, until this daemon
        gets a request; the last one is held when no more of them come.
        """
        if order.value > 0.0 and (self.sent is None or self._theirs):
            self._take_over(t_ns, order)
        elif order.value <= 0.0 and self._theirs:
            self.sent = self.target = None
            self._theirs, self._released_ns = False, t_ns

    def _take_over(self, t_ns: int, running: SetPoint) -> None:
        """Hold a fan that runs when the daemon starts as it runs, in a quantity that the spec allows."""
        if running.quantity not in self._spec.highest:
            return
        new = not self._released_ns and t_ns - self._born(t_ns) <= _LISTEN_NS
        if self._adopts and (new or self._theirs):
            self.resume(t_ns, running, running)
            self._theirs = True

    def resume(self, t_ns: int, sent: SetPoint, target: SetPoint) -> None:
        """Go on from a set-point that another process has sent until now."""
        self._born(t_ns)
        self._last_ns = t_ns
        self.sent, self.target, self.ending = self._clipped(sent), self._clipped(target), False
        self.trim.begin()

    def set_target(self, t_ns: int, wanted: SetPoint) -> None:
        """Change the set-point; cancels an `end` that is under way.

        Raises:
            UsageError: the set-point is not valid; the present one stays.
            DeviceError: the fan does not report how it runs, so a start could be a step.
        """
        self._born(t_ns)
        check_point(self._spec, wanted)
        if self.sent is None or self.sent.quantity != wanted.quantity:
            self.sent = self._clipped(SetPoint(wanted.quantity, self._measured(t_ns, wanted.quantity)))
            self._last_ns = t_ns
        self.target, self.ending, self._theirs = wanted, False, False
        self.trim.begin()

    @property
    def aim(self) -> SetPoint | None:
        """The set-point with its correction: where the ramp leads, and what another process goes on with."""
        if self.target is None or self.ending or self.target.quantity != "duty":
            return self.target
        return self._clipped(SetPoint("duty", self.target.value * self.trim.lift))

    def end(self, t_ns: int) -> None:
        """Let the fan come to rest along the ramp. The caller has confirmed that nothing hangs by it."""
        self._born(t_ns)
        if self.sent is not None:
            self.target, self.ending, self._theirs = SetPoint(self.sent.quantity, 0.0), True, False

    def next_command(self, t_ns: int) -> SetPoint | None:
        """The set-point to send now; None while the fan is not commanded."""
        self._born(t_ns)
        step_s = min(t_ns - self._last_ns, _LONGEST_STEP_NS) / NS_PER_S
        self._last_ns = t_ns
        towards = self.aim
        if self.sent is None or towards is None:
            return RELEASE if t_ns < self._released_ns else None
        quantity, value = self.sent
        highest, aim = self._spec.highest[quantity], towards.value
        if aim >= value:
            value = min(aim, value + step_s * highest / self._spec.ramp_up_s)
        else:
            value = max(aim, value - step_s * highest / self._spec.ramp_down_s)
        self.sent = SetPoint(quantity, value)
        if self.ending and value <= 0.0:
            self.sent = self.target = None
            self.ending, self._released_ns = False, t_ns + _RELEASED_NS
            return RELEASE
        return self.sent

    def state(self) -> str:
        """`keeping`, `ending`, or `idle` while the fan is not commanded."""
        return "idle" if self.sent is None else "ending" if self.ending else "keeping"

    def _born(self, t_ns: int) -> int:
        """When control began: the time of its first call."""
        if self._born_ns is None:
            self._born_ns = self._last_ns = t_ns
        return self._born_ns

    def _clipped(self, point: SetPoint) -> SetPoint:
        return SetPoint(point.quantity, min(max(point.value, 0.0), self._spec.highest[point.quantity]))

    def _measured(self, t_ns: int, quantity: str) -> float:
        """How the fan runs now, by the median of its reports; raises `DeviceError` where it is silent."""
        newest_ns = self.report_ns
        if newest_ns is None or t_ns - newest_ns > _FRESH_NS:
            raise self._silent()
        found = [values.get(quantity) for at_ns, values in self._recent if newest_ns - at_ns <= _TOGETHER_NS]
        known = sorted(value for value in found if value is not None)
        if not known:
            raise self._silent()
        return known[len(known) // 2]

    def _silent(self) -> DeviceError:
        heard = ", ".join(map(str, sorted(self.others)[:_MOST_LISTED]))
        remedy = (
            f"check first the CAN bit rate ({self._spec.device}.bitrate = {self._spec.bitrate}), then wiring "
            "and its supply; switch on status messages 1, 4 and 5 in VESC Tool"
        )
        return DeviceError(
            self._spec.device,
            f"controller {self._spec.controller_id} sends no status"
            + (f", but controller {heard} does" if heard else ""),
            port=self._spec.bus,
            expected="status message 1 at 5 Hz or more",
            remedy=f"set the controller's id in [{self._spec.device}], or {remedy}" if heard else remedy,
        )
