"""Compares the measured fan force with the needed one, and its measurements with each other.

The force is measured by the load cells, minus their zeros, and by the fan's controller: by the speed, by duty
and voltage, by the power. The force that counts is the one on which two agree, else the smallest
(`hil.robot.believed_force`). The robot stops while there is still a margin for stopping: at a limit above the
needed force, and earlier if the force is falling. Propellers that turn faster than commanded push less than
their speed suggests: that stops the robot, too.
"""

from __future__ import annotations

import math

from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.interfaces import ReportStop
from hil.core.signals import WHEELS, AdhesionSample, Event, Inputs, Status
from hil.loop.checks.adhesion_limits import AdhesionLimits, FanForces, SlidePush
from hil.loop.checks.force_trend import ForceTrend
from hil.loop.cycle_data import Check, Cycle, go_on
from hil.robot.believed_force import CELLS, Believed, apart
from hil.robot.motor_cross_checks import POWER, SPEED, VOLTAGE

_FALLING_N_S = -3.0
_AHEAD_S = 0.5
"""A force that will be below its limit within this time (s) stops the robot: wheels take 0.15 s to stop."""
_DISAGREE_NS = nanoseconds(0.25)
_LASTS_NS = nanoseconds(0.5)
"""Time for which a low battery or a hot controller is reported before the stop: five messages of VESCs that
report them ten times a second, as one may be damaged."""
_SAME_SHARE, _SAME_RAD = 0.005, 0.002
_WEAK_PUSH = 0.85
"""Share of the commanded push below which the message of a stop mentions the propellers."""
_OK = Status.OK
_WHOSE = "the fan's"
_NO_DIGITS = str.maketrans("", "", "0123456789.-")
_LETTING_GO = ("adhesion", "utilisation", "thrust_disagree")
"""Reasons to stop for which a higher force helps."""
_MAY_SLIDE = ("sensors_disagree", "sliding", "tracking", "heading")
"""Reasons to stop of a robot that may be sliding already: a hanging one is pressed harder."""


def presses_harder(reason: str, hold: AdhesionWatch | None) -> bool:
    """Whether fan and propellers are raised after a stop for this reason; `hold`: check of the force."""
    return reason in _LETTING_GO or (reason in _MAY_SLIDE and hold is not None and hold.can_fall)


class AdhesionWatch(Check):
    """Checks fan, propellers and load cells during one run.

    Args:
        limits: limits of the bench.
        can_fall: True if the robot hangs on a wall without a tether; else this check never stops it.

    Attributes:
        limits, can_fall: arguments as given.
        heading_rad: last estimated heading of the body.
        figures: figures for the robot's state: force, needed force, margin, and friction utilisation of each
            wheel.
    """

    def __init__(self, limits: AdhesionLimits, *, can_fall: bool) -> None:
        self.limits, self.can_fall = limits, can_fall
        self._has_fan, self._has_cells = limits.has_fan, limits.zero_n is not None
        self._stale_ns = nanoseconds(limits.stale_s)
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self.heading_rad = 0.0
        self.figures: dict[str, float] = {}
        self._thrust_n = self._reported_push_n = self.limits.nominal_thrust_n
        self._cells_n = self._speed_n = math.nan
        self._worked_out_at = (math.nan, math.nan, math.nan)
        self._needed_n = self._most = 0.0
        self._used: dict[str, float] = {}
        self._cells_ns: int | None = None
        self._fan_ns: int | None = None
        self._thrust_ns: int | None = None
        self._began_ns: int | None = None
        self._cells_trend, self._speed_trend = ForceTrend(), ForceTrend()
        self._apart_ns: int | None = None
        self._excess_ns: int | None = None
        self._trouble = self._push_trouble = ""
        self._by_fan = FanForces(self.limits.fan)
        self._believed = Believed(math.nan)
        self._split = False
        self._fan: AdhesionSample | None = None
        self._good_volts_ns: int | None = None
        self._cool_ns: int | None = None

    def on_samples(self, cycle: Cycle) -> None:
        """Check fan, propellers and load cells; adds their figures to the robot's state."""
        self.heading_rad = cycle.last.heading_rad
        self.judge(cycle.inputs, cycle.events, cycle.stop)
        cycle.diagnostics.update(self.figures)

    def judge(self, inputs: Inputs, events: list[Event], stop: ReportStop) -> None:
        """Check one cycle's samples; adds findings to `events`, or calls `stop`.

        The force is checked with every report of the fan, 50 times a second.
        """
        if self._began_ns is None:
            self._began_ns = inputs.t_ns
        self._take(inputs, events)
        fresh = self._fresh(inputs.t_ns, stop if self.can_fall else go_on)
        if not (inputs.adhesion if self._has_fan else inputs.load_cells):
            return
        self._believed = self.limits.believed(self._forces())
        force_n = self._believed.force_n
        self._figure(force_n)
        if not self.can_fall or not math.isfinite(force_n) or not fresh:
            return
        self._judge_force(force_n, stop)
        self._compare(inputs.t_ns, events, stop)
        self._judge_push(stop)
        if self._fan is not None:
            self._judge_controller(self._fan, force_n, stop)

    def push_against(self, along_m: float) -> SlidePush | None:
        """Set-point of the propellers against a slide (m along body x); None where it stays as it is."""
        return self.limits.push_against(along_m, self._believed.force_n, self.heading_rad)

    def _forces(self) -> dict[str, float]:
        """The newest force by each measurement, N."""
        cells = {CELLS: self._cells_n} if math.isfinite(self._cells_n) else {}
        return {**self._by_fan.forces_n, **cells}

    def _take(self, inputs: Inputs, events: list[Event]) -> None:
        """Update the newest force by each sensor."""
        for sample in inputs.load_cells if self._has_cells else ():
            if sample.status[0] is _OK and sample.status[1] is _OK:
                self._cells_n, self._cells_ns = self.limits.cells_n(sample), sample.stamp.t_ns
                self._cells_trend.follow(self._cells_ns, self._cells_n)
        for fan in inputs.adhesion if self._has_fan else ():
            self._take_fan(fan, inputs.t_ns, events)
        for push in inputs.thrust:
            push_n = self.limits.push_n(push)
            self._push_trouble = push.trouble
            if math.isfinite(push_n) or push.trouble:
                self._take_push(push_n, push.stamp.t_ns)

    def _take_fan(self, fan: AdhesionSample, t_ns: int, events: list[Event]) -> None:
        """Update the forces by the fan's controller, and what its measurements say about each other.

        A report beyond a physical bound counts by duty and voltage alone.
        """
        if _without_digits(fan.trouble) != _without_digits(self._trouble):
            self._trouble = fan.trouble
            message = fan.trouble or "the fan is kept running as it should be again"
            events.append(Event(t_ns, "warning" if fan.trouble else "info", "adhesion", message))
        if not self._by_fan.take(fan) or fan.status is not _OK:
            return
        self._fan, self._fan_ns = fan, fan.stamp.t_ns
        self._speed_n = self.limits.speed_n(fan)
        self._speed_trend.follow(self._fan_ns, self._speed_n)

    def _take_push(self, push_n: float, t_ns: int) -> None:
        """Update the push of the propellers; for one that cannot be real the commanded push is used."""
        self._reported_push_n, self._thrust_ns = push_n, t_ns
        if not (self.limits.pushes_too_much(push_n) or self._push_trouble):
            self._thrust_n, self._excess_ns = push_n, None
            return
        self._thrust_n = self.limits.nominal_thrust_n
        if self._excess_ns is None:
            self._excess_ns = t_ns

    def _fresh(self, t_ns: int, stop: ReportStop) -> bool:
        """Whether every force sensor has reported recently; calls `stop` if one is silent."""
        oldest_ns = t_ns - self._stale_ns
        if (self._began_ns or 0) >= oldest_ns:
            return True
        fresh = True
        if self._has_fan and (self._fan_ns or 0) < oldest_ns:
            fresh = self._silent("adhesion", "fan's controller", self._fan_ns, t_ns, stop)
        if self._has_cells and (self._cells_ns or 0) < oldest_ns:
            fresh = self._silent("load_cells", "load cells", self._cells_ns, t_ns, stop)
        if self.limits.reports_thrust and (self._thrust_ns or 0) < oldest_ns:
            fresh = self._silent("thrust", "propellers' controllers", self._thrust_ns, t_ns, stop)
        return fresh

    def _silent(self, name: str, noun: str, last_ns: int | None, t_ns: int, stop: ReportStop) -> bool:
        """Stop because no sensor measures the force; False, as nothing fresh is known."""
        if name == "adhesion" and self._by_fan.impossible:
            stop("adhesion_disagree", f"{self._by_fan.impossible}; `hil doctor` at rest")
            return False
        silent_s = (t_ns - max(last_ns or 0, self._began_ns or 0)) / NS_PER_S
        stop(
            f"stale_{name}",
            f"nothing usable from the {noun} for {silent_s:.2f} s: whether the robot is pressed on the wall "
            "is not known; check its bus (bit rate, wiring, adapter) and its supply",
        )
        return False

    def _figure(self, force_n: float) -> None:
        """Update the figures; the statics are recomputed if force or heading have changed."""
        self._work_out(force_n)
        self.figures = {
            "adhesion_n": force_n,
            "adhesion_needed_n": self._needed_n,
            "adhesion_margin_n": force_n - self._needed_n,
            **self._used,
        }
        if math.isfinite(self._cells_n):
            self.figures["adhesion_cells_n"] = self._cells_n
        if math.isfinite(self._speed_n):
            self.figures["adhesion_fan_n"] = self._speed_n

    def _work_out(self, force_n: float) -> None:
        """Compute needed force, margin, and friction utilisation of each wheel."""
        at_n, at_thrust_n, at_rad = self._worked_out_at
        if (
            abs(force_n - at_n) <= _SAME_SHARE * at_n
            and abs(self.heading_rad - at_rad) <= _SAME_RAD
            and abs(self._thrust_n - at_thrust_n) <= _SAME_SHARE * at_thrust_n
        ):
            return
        self._worked_out_at = (force_n, self._thrust_n, self.heading_rad)
        statics = self.limits.statics
        self._needed_n = statics.needed_n(self._thrust_n, self.heading_rad)
        self._used = {}
        if math.isfinite(force_n):
            used = statics.utilisation(force_n, self._thrust_n, self.heading_rad)
            self._used = {f"utilisation_{w}": u for w, u in zip(WHEELS, used, strict=True)}
        self._most = max(self._used.values(), default=0.0)

    def _judge_force(self, force_n: float, stop: ReportStop) -> None:
        """Check the present and predicted force, and the friction utilisation of the wheels."""
        limit_n = self.limits.asked_share * self._needed_n
        measure, rate_n_s = "", 0.0
        for name, trend in ((CELLS, self._cells_trend), (SPEED, self._speed_trend)):
            if name not in self._believed.against and (slope := trend.slope_n_s()) < rate_n_s:
                measure, rate_n_s = name, slope
        falling = rate_n_s < _FALLING_N_S
        soon_n = force_n + _AHEAD_S * rate_n_s if falling else force_n
        if soon_n >= limit_n and self._most <= self.limits.utilisation:
            return
        message = f"{force_n:.1f} N of adhesion{self._by_whom()}, {self._left(force_n)}"
        if falling:
            left_s = max((force_n - self._needed_n) / -rate_n_s, 0.0)
            message += f", falling by {-rate_n_s:.1f} N/s by {measure}: {left_s:.1f} s are left "
            message += "until the robot slides"
        if force_n < limit_n:
            least = f"{limit_n:.1f} N are the least on this surface ({self._needed_n:.1f} needed)"
            stop("adhesion", f"{message}; {least}{self._weak_push()}")
        elif soon_n < limit_n:
            stop("adhesion", f"{message}; look at fan, battery and seal{self._weak_push()}")
        if self._most > self.limits.utilisation:
            wheel = max(WHEELS, key=lambda w: self._used[f"utilisation_{w}"])
            stop(
                "utilisation",
                f"wheel {wheel} uses {100 * self._most:.0f} % of its friction, more than "
                f"{100 * self.limits.utilisation:.0f} %: {message}{self._weak_push()}; it is computed with "
                f"{', '.join(self.limits.load_keys)}{self._way_out()}",
            )

    def _way_out(self) -> str:
        """Text on what to do after a stop that raises the fan."""
        if not self.limits.has_fan:
            return ""
        return (
            "; the fan is raised now, and the next session leaves it so: turn the robot back to upright, or "
            "bring it down; once it is secured, `hil adhesion on --tethered` lowers the force"
        )

    def _by_whom(self) -> str:
        """Text on the measurement of the force that counts, if another contradicts it; else empty."""
        if not self._believed.against:
            return ""
        others = ", ".join(f"{force_n:.1f} N by {name}" for name, force_n in self._believed.against.items())
        return f" by {self._believed.by} ({others}: one of them is wrong, or air leaks under the robot)"

    def _weak_push(self) -> str:
        """Text if the reported push is too small: less push needs more adhesion; else empty."""
        wanted_n = self.limits.nominal_thrust_n
        if not self.limits.reports_thrust or self._thrust_n >= _WEAK_PUSH * wanted_n:
            return ""
        return (
            f"; the propellers report {self._thrust_n:.1f} N of the {wanted_n:.1f} N that they are to give: "
            "look at their controllers, battery and blades"
        )

    def _left(self, force_n: float) -> str:
        """Text on the remaining margin."""
        margin_n, whole_n = force_n - self._needed_n, self.limits.wanted_n - self._needed_n
        share = f" ({100.0 * max(margin_n, 0.0) / whole_n:.0f} %)" if whole_n > 0.0 else ""
        return f"{margin_n:.1f} N of margin left{share}"

    def _compare(self, t_ns: int, events: list[Event], stop: ReportStop) -> None:
        """Compare load cells, speed, duty and voltage; where they contradict each other the others decide."""
        contradiction = self._by_fan.contradiction
        split = bool(contradiction)
        cells_known = math.isfinite(self._cells_n)
        agree = cells_known and not apart(self._cells_n, self._speed_n)
        if agree and split and not self._split:
            message = f"load cells and fan's speed agree, but {contradiction}"
            events.append(Event(t_ns, "warning", "adhesion", message))
        self._split = split
        if not apart(self._cells_n, self._speed_n) and (agree or not split):
            self._apart_ns = None
            return
        if self._apart_ns is None:
            self._apart_ns = t_ns
        if t_ns - self._apart_ns < _DISAGREE_NS or self._fan is None:
            return
        message = f"{self._cells_against_fan()}; " if cells_known else ""
        if split:
            message += f"{contradiction}; "
        stop("adhesion_disagree", f"{message}`hil run adhesion_check` at rest")

    def _cells_against_fan(self) -> str:
        """Text on the forces by load cells and fan, and which of them is wrong."""
        message = f"the load cells say {self._cells_n:.1f} N, the fan's speed {self._speed_n:.1f} N"
        known = [
            (name, self._by_fan.forces_n[name]) for name in (VOLTAGE, POWER) if name in self._by_fan.forces_n
        ]
        if not known:
            return f"{message}; neither its voltage nor its current is reported"
        for name, force_n in known:
            message += f", {name.replace(_WHOSE, 'its', 1)} {force_n:.1f} N"
        for_speed = [abs(n - self._speed_n) < abs(n - self._cells_n) for _, n in known]
        if all(for_speed):
            return f"{message}: the cells are wrong, or air leaks under the robot"
        if not any(for_speed):
            return f"{message}: the reported speed is wrong"
        return f"{message}: they do not agree either"

    def _judge_push(self, stop: ReportStop) -> None:
        """Stop if propellers have reported too much push for a while: their real push is unknown."""
        if self._excess_ns is None or (self._thrust_ns or 0) - self._excess_ns < _DISAGREE_NS:
            return
        message = f"the propellers' reports contradict each other: {self._push_trouble}"
        if self.limits.pushes_too_much(self._reported_push_n):
            message = (
                f"the propellers report {self._reported_push_n:.1f} N of push, more than the "
                f"{self.limits.nominal_thrust_n:.1f} N that they are to give: they turn faster than asked, "
                "and what they really give is not known; look for a lost blade or a loose propeller, then at "
                "the motors' speed sensing, and at what else commands their controllers"
                + f"; {self._push_trouble}"
                * bool(self._push_trouble)
            )
        stop("thrust_disagree", message)

    def _judge_controller(self, fan: AdhesionSample, force_n: float, stop: ReportStop) -> None:
        """Check battery voltage and controller temperature of the fan, which count once they last."""
        limits, t_ns = self.limits, fan.stamp.t_ns
        if self._good_volts_ns is None or not fan.input_v < limits.low_input_v:
            self._good_volts_ns = t_ns
        if self._cool_ns is None or not fan.fet_c > limits.hot_fet_c:
            self._cool_ns = t_ns
        if t_ns - self._good_volts_ns >= _LASTS_NS:
            stop(
                "battery_low",
                f"the fan's battery has {fan.input_v:.1f} V under load, less than {limits.low_input_v:g}: "
                f"{self._left(force_n)}; bring the robot down",
            )
        if t_ns - self._cool_ns >= _LASTS_NS:
            stop(
                "fan_hot",
                f"the fan's controller is at {fan.fet_c:.0f} degC, more than {limits.hot_fet_c:g}: it will "
                f"slow the fan down by itself; {self._left(force_n)}",
            )


def _without_digits(text: str) -> str:
    """A text without its numbers: the same trouble with other figures is no new event."""
    return text.translate(_NO_DIGITS)
