"""Checks the servos' own data: silence, alerts, wheels that do not turn, encoders that slip.

Messages name the servo, its bus ID where known, the fault and the remedy.
"""

import math

from hil.config.servo_models.x_series_codes import hardware_error_text
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.geometry import wrap
from hil.core.interfaces import ReportStop
from hil.core.signals import SERVOS, WHEELS, EncoderSample, Event, Inputs, ServoSample, Status
from hil.loop.checks.dead_reckoning import FASTEST_RAD_S, STEP_RAD
from hil.loop.checks.loop_pause import LoopPause
from hil.loop.cycle_data import Check, Cycle

_BLOCKED_NS, _STANDING_NS = 500_000_000, 150_000_000
_BLOCKED_RATE_RAD_S, _BLOCKED_RAD = 0.5, 0.05
_WAITS_SHARE = 0.4
"""Share of the longest time without a complete read after which the wheels wait."""
_REPORT_NS = 50_000_000
"""Time from a step of an encoder to the stop, ns."""
_ALL_OK = (Status.OK,) * len(SERVOS)
_REMEDIES = {
    Status.HARDWARE_ERROR: "remove the cause, then reboot it",
    Status.RESET: "it has restarted: check its supply",
    Status.CRC: "its packets arrive damaged: check cable, ground and baud rate",
    Status.PROTOCOL: "check that no two servos have the same ID",
    Status.TIMEOUT: "check its cable, its supply and its ID",
}
"""The most specific status comes first: a damaged servo makes those behind it in the chain silent."""


class ServoCheck(Check):
    """Checks the servos of one run.

    Args:
        stale_s: longest time without a complete read, s; None without servos.
        pause: check of the loop's pauses, which runs earlier in each cycle.
        ids: bus IDs in the order of `SERVOS`; empty when unknown.

    Attributes:
        asked_rad_s: (4,) last commanded wheel rates.
        names: servos in messages, with bus IDs where known.
        waits: True after no complete read for so long that the wheels wait for the next one. Where commands
            still arrive, and no answers, no watchdog of the servos trips: the robot would go on until the
            stop.
    """

    def __init__(self, stale_s: float | None, pause: LoopPause, ids: tuple[int, ...] = ()) -> None:
        self._pause = pause
        self._stale_ns = None if stale_s is None else nanoseconds(stale_s)
        self.names = tuple(f"{s} (ID {i})" for s, i in zip(SERVOS, ids, strict=True)) if ids else SERVOS
        self.reset()

    def reset(self) -> None:
        """Clear the state of the run."""
        self.asked_rad_s = [0.0] * 4
        self._asked_since_ns: list[int | None] = [None] * 4
        self._asked_at_rad, self._asked_read_ns = [0.0] * 4, [0] * 4
        self._complete_ns: int | None = None
        self._lost_ns = 0
        self._excused = self.waits = False
        self._missed: dict[int, tuple[int, Status]] = {}
        self._last_rad, self._last_ns = [math.nan] * len(SERVOS), [0] * len(SERVOS)
        self._outside = [math.nan] * 4
        self._slipped: tuple[int, str] | None = None

    def on_samples(self, cycle: Cycle) -> None:
        """Check for alerts, wheels that do not turn, encoder steps and silence."""
        self.asked_rad_s = cycle.last.wheel_rate_rad_s
        self.judge(cycle.inputs, cycle.events, cycle.stop)
        self._check_goals(cycle.inputs, cycle.events)
        self.check_silence(cycle.inputs, cycle.stop)

    def judge(self, inputs: Inputs, events: list[Event], stop: ReportStop) -> None:
        """Check one cycle's reads; adds findings to `events`, or calls `stop`.

        Args:
            inputs: samples of this cycle.
            events: list that receives findings.
            stop: called with the reason to stop.
        """
        outside, self._outside = self._outside, _outside(inputs.encoders, self._outside)
        for sample in inputs.servos:
            if any(sample.alert):
                stop("hardware_error", self._alerts(sample.alert))
            angles: list[float] = sample.position_rad.tolist()
            self._check_turning(angles, inputs.t_ns, stop)
            self._check_steps(sample, angles, outside, events)
        if self._slipped is not None and inputs.t_ns - self._slipped[0] > _REPORT_NS:
            stop("servo_jump", f"{self._slipped[1]}: no motor turns so fast: slipped encoder, or old values")

    def _check_goals(self, inputs: Inputs, events: list[Event]) -> None:
        """Report goals that the driver has clipped."""
        for health in inputs.health:
            if any(health.clipped):
                named = ", ".join(f"{self.names[j]} {n} times" for j, n in enumerate(health.clipped) if n)
                message = (
                    f"goals were clipped: {named}; a wheel is not where the setpoint says. Compare the "
                    "finding `limits` of `hil doctor` with alignment.steer_zero_rad and [safety]"
                )
                events.append(Event(inputs.t_ns, "warning", "servos", message))

    def check_silence(self, inputs: Inputs, stop: ReportStop) -> None:
        """Stop with `stale_servos` if the last complete read is too old.

        The first pause of the loop since that read does not count: the servos were not read in it. Nor does
        time that this computer has lost; the wheels wait all the same.
        """
        if self._stale_ns is None:
            return
        if self._complete_ns is None:
            self._complete_ns = inputs.t_ns
        lost_ns = self._pause.lost_ns("servos")
        if paused_ns := 0 if self._excused else self._pause.ended_at(inputs.t_ns):
            self._complete_ns, self._excused = self._complete_ns + paused_ns, True
        else:
            self._lost_ns += lost_ns
        for sample in inputs.servos:
            if sample.status == _ALL_OK:
                self._complete_ns, self._missed, self._excused = inputs.t_ns, {}, False
                self._lost_ns = 0
                continue
            for j, status in enumerate(sample.status):
                if status is not Status.OK:
                    self._missed[j] = (self._missed.get(j, (0, status))[0] + 1, status)
        silent_ns = inputs.t_ns - self._complete_ns
        self.waits = silent_ns > _WAITS_SHARE * self._stale_ns
        if silent_ns - self._lost_ns > self._stale_ns:
            stop("stale_servos", f"no complete servo read for {silent_ns / NS_PER_S:.3f} s: {self._failed()}")

    def _failed(self) -> str:
        """Text: servos that missed most reads since the last complete one, with status and remedy.

        A silent servo makes others of its chain silent for a read or two; these are left out.
        """
        most = max((count for count, _ in self._missed.values()), default=0)
        missed = {j: status for j, (count, status) in sorted(self._missed.items()) if 2 * count > most}
        kinds = set(missed.values())
        if not missed or (len(missed) == len(SERVOS) and kinds == {Status.TIMEOUT}):
            return (
                "none of the eight answers in time; check the servos' supply, the bus cable, the adapter and "
                "the baud rate; one late servo delays all (the check after the stop names it)"
            )
        found = ", ".join(f"{self.names[j]}: {status.value}" for j, status in missed.items())
        known = [remedy for status, remedy in _REMEDIES.items() if status in kinds]
        return "; ".join((found, *known[:1]))

    def _alerts(self, alert: tuple[int, ...]) -> str:
        found = ", ".join(f"{self.names[j]}: {hardware_error_text(a)}" for j, a in enumerate(alert) if a)
        return f"servo alert of {found}; remove the cause, then reboot the servo"

    def _check_turning(self, angles: list[float], t_ns: int, stop: ReportStop) -> None:
        """Stop if a wheel is commanded to turn and reports the same angle: blocked, or its servo is stuck.

        A lost read shows neither motion nor rest.
        """
        blocked, all_since_ns, at_rad = False, self._asked_since_ns, self._asked_at_rad
        for i, asked_rad_s in enumerate(self.asked_rad_s):
            since_ns, angle = all_since_ns[i], angles[i]
            if -_BLOCKED_RATE_RAD_S < asked_rad_s < _BLOCKED_RATE_RAD_S:
                all_since_ns[i] = None
                continue
            if not math.isfinite(angle):
                continue
            self._asked_read_ns[i] = t_ns
            if since_ns is None or abs(angle - at_rad[i]) > _BLOCKED_RAD:
                all_since_ns[i], at_rad[i] = t_ns, angle
            elif t_ns - since_ns > _BLOCKED_NS:
                blocked = True
        if blocked:
            stop("blocked", self.standing(_BLOCKED_NS))

    def standing(self, longer_than_ns: int = _STANDING_NS) -> str:
        """Text: wheels that were commanded to turn for so long and report the same angle; else empty."""
        found = [
            f"wheel {WHEELS[i]} is asked for {self.asked_rad_s[i]:.2f} rad/s and has not turned for "
            f"{(read_ns - since_ns) / NS_PER_S:.1f} s"
            for i, (since_ns, read_ns) in enumerate(
                zip(self._asked_since_ns, self._asked_read_ns, strict=True)
            )
            if since_ns is not None and read_ns - since_ns > longer_than_ns
        ]
        return f"{', '.join(found)}: blocked, or its servo repeats old values" if found else ""

    def _check_steps(
        self, sample: ServoSample, angles: list[float], outside: list[float], events: list[Event]
    ) -> None:
        """Find steps that no motor can make: the servo's encoder has slipped."""
        t_ns, last_rad = sample.stamp.t_ns, self._last_rad
        if sample.status == _ALL_OK:
            for j in range(len(SERVOS)):
                if not -STEP_RAD <= angles[j] - last_rad[j] <= STEP_RAD:
                    break
            else:
                self._last_rad, self._last_ns = angles, [t_ns] * len(SERVOS)
                return
        for j in range(len(SERVOS)):
            if sample.status[j] is Status.OK:
                step_rad = angles[j] - last_rad[j]
                dt_s = max(t_ns - self._last_ns[j], 0) / NS_PER_S
                self._last_rad[j], self._last_ns[j] = angles[j], t_ns
                if abs(step_rad) > STEP_RAD + FASTEST_RAD_S * dt_s:
                    self._leapt(j, step_rad, dt_s, t_ns, outside, events)

    def _leapt(
        self, j: int, step_rad: float, dt_s: float, t_ns: int, outside: list[float], events: list[Event]
    ) -> None:
        """Report a step, with the turn of the steering axis' external encoder since `outside`."""
        said = f"{self.names[j]} reports a step of {step_rad:+.2f} rad in {1e3 * dt_s:.0f} ms"
        if j >= 4 and math.isfinite(turned := self._outside[j - 4] - outside[j - 4]):
            said += f"; the external encoder {WHEELS[j - 4]} turned by {abs(wrap(turned)):.2f} rad"
        events.append(Event(t_ns, "warning", "servos", said))
        before = f"{self._slipped[1]}, " if self._slipped is not None else ""
        self._slipped = (t_ns, before + said)


def _outside(samples: tuple[EncoderSample, ...], before: list[float]) -> list[float]:
    """Newest known angles of the external encoders (4,), rad."""
    if not samples:
        return before
    angles: list[float] = samples[-1].angle_rad.tolist()
    if math.isfinite(sum(angles)):
        return angles
    return [a if math.isfinite(a) else b for a, b in zip(angles, before, strict=True)]
