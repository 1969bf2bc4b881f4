"""Compares external encoders with the servos' own angles: finds slipped horns and damaged gears.

The servo measures before backlash and horn, the external encoder after them. Their lasting difference changes
when the horn or the servo's own encoder slips. Only settled axes are compared, because the two are not
sampled at the same instant.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hil.config.encoders import EncodersConfig
from hil.core.geometry import wrap
from hil.core.interfaces import ReportStop
from hil.core.signals import WHEELS, Event, Inputs, Measurements
from hil.loop.cycle_data import Check, Cycle, go_on

_SETTLED_RAD = 0.016
_LEARN, _ASTRAY_RAD = 5, 0.15
_MEMORY = 0.2
_NAN = math.nan
_EVERY_NS, _REPORT_NS, _FAR = 48_000_000, 50_000_000, 2.0


@dataclass(frozen=True)
class CrossCheckResult:
    """Diagnostic per axis, wheel order, four each.

    Attributes:
        difference_rad: encoder minus servo, relative to the offset learnt at the start, smoothed; NaN if
            unknown.
        now_rad: the same for the newest settled pair, not smoothed.
        horn_slip: the lasting difference exceeds the threshold.
    """

    difference_rad: tuple[float, ...]
    now_rad: tuple[float, ...]
    horn_slip: tuple[bool, ...]


class _Axis:
    """One steering axis; plain floats, because it is used in every run.

    Args:
        known_rad: expected difference; None if unknown.
        astray_rad: deviation from it beyond which the learnt offset is wrong.
    """

    def __init__(self, known_rad: float | None, astray_rad: float) -> None:
        self._known_rad, self._astray_rad = known_rad, astray_rad
        self.count, self.reference, self.lasting, self.latest = 0, 0.0, _NAN, _NAN
        self.last_servo = _NAN

    @property
    def difference_rad(self) -> float:
        """Smoothed difference from the learnt offset, rad; NaN before it is learnt."""
        return wrap(self.lasting - self.reference) if self.count >= _LEARN else _NAN

    @property
    def now_rad(self) -> float:
        """The newest difference from the learnt offset, rad."""
        return wrap(self.latest - self.reference)

    def update(self, raw_rad: float, servo_rad: float) -> None:
        """Process encoder minus servo angle, which may include whole turns, and the servo's angle."""
        settled = abs(servo_rad - self.last_servo) < _SETTLED_RAD
        self.last_servo = servo_rad
        if settled and math.isfinite(raw_rad):
            self._learn(raw_rad)

    def _learn(self, raw_rad: float) -> None:
        count, self.count, self.latest = self.count, self.count + 1, raw_rad
        if count < _LEARN:
            self.reference = wrap(self.reference + wrap(raw_rad - self.reference) / (count + 1))
            self.lasting = self.reference
            if self.count == _LEARN:
                self._correct()
            return
        self.lasting = wrap(self.lasting + _MEMORY * wrap(raw_rad - self.lasting))

    def _correct(self) -> None:
        """Replace the learnt offset by the known one if they differ too much."""
        known_rad = self._known_rad
        if known_rad is not None and abs(wrap(self.reference - known_rad)) > self._astray_rad:
            self.reference = known_rad


class CrossCheck:
    """Tracks the difference of two angles per steering axis; call `update` every 50 ms.

    The offset learnt at the start is used, unless it is far from the known zeros of the encoders, or from a
    difference that was measured before.

    Args:
        config: settings of the encoders.
        measured_rad: (4,) difference that was measured before; None without one.
    """

    def __init__(self, config: EncodersConfig, measured_rad: Sequence[float] | None = None) -> None:
        self._config, self._measured_rad = config, measured_rad
        self.reset()

    def reset(self) -> None:
        """Learn the offset again (after the horn has been refitted)."""
        if self._measured_rad is not None:
            astray_rad = self._config.horn_slip_threshold_rad
            self._axes = tuple(_Axis(measured_rad, astray_rad) for measured_rad in self._measured_rad)
            return
        known_rad = None if self._config.zero_rad is None else 0.0
        self._axes = tuple(_Axis(known_rad, _ASTRAY_RAD) for _ in range(4))

    def update(self, encoder_rad: Sequence[float], servo_rad: Sequence[float]) -> CrossCheckResult:
        """Compare one pair of readings.

        Args:
            encoder_rad: (4,) angles of an `EncoderSample`, NaN where unusable.
            servo_rad: (4,) steering angles of the servos, body convention, NaN where unusable.
        """
        config = self._config
        for axis, encoder, servo, sign, zero in zip(
            self._axes, encoder_rad, servo_rad, config.sign, config.zeros_rad, strict=True
        ):
            axis.update(sign * (encoder - zero) - servo, servo)
        difference = tuple([axis.difference_rad for axis in self._axes])
        return CrossCheckResult(
            difference_rad=difference,
            now_rad=tuple([axis.now_rad for axis in self._axes]),
            horn_slip=tuple([abs(x) > config.horn_slip_threshold_rad for x in difference]),
        )


class SteeringWatch(Check):
    """The cross-check of a running robot: reports a slipped horn, and stops the robot.

    Args:
        config: settings of the encoders.
        ids: bus IDs of the four steering servos; empty when unknown.
        measured_rad: (4,) difference that was measured before, as in `CrossCheck`.
        stops: True if a slipped horn stops the robot; else it is only reported.
    """

    def __init__(
        self,
        config: EncodersConfig,
        ids: tuple[int, ...] = (),
        measured_rad: Sequence[float] | None = None,
        *,
        stops: bool = True,
    ) -> None:
        self._stops = stops
        self._check = CrossCheck(config, measured_rad)
        self._threshold_rad = config.horn_slip_threshold_rad
        named = [f" (ID {i})" for i in ids] or [""] * 4
        self._names = tuple(f"steer_{wheel}{name}" for wheel, name in zip(WHEELS, named, strict=True))
        self.reset()

    def reset(self) -> None:
        """Clear the learnt offsets."""
        self._check.reset()
        self._last_ns: int | None = None
        self._since_ns: dict[int, int] = {}

    def on_samples(self, cycle: Cycle) -> None:
        """Compare external encoders with the servos."""
        stop = cycle.stop if self._stops else go_on
        self.judge(cycle.inputs, cycle.measurements, cycle.events, stop)

    def judge(
        self, inputs: Inputs, measurements: Measurements, events: list[Event], stop: ReportStop
    ) -> None:
        """Compare one cycle's newest angles: an event if they differ, `stop` for a large lasting difference.

        Args:
            inputs: samples of this cycle.
            measurements: the same, aligned.
            events: list that receives findings.
            stop: called with the reason to stop.
        """
        t_ns, last_ns = inputs.t_ns, self._last_ns
        if not (inputs.encoders and measurements.wheels) or (
            last_ns is not None and t_ns - last_ns < _EVERY_NS
        ):
            return
        self._last_ns = t_ns
        outside: list[float] = inputs.encoders[-1].angle_rad.tolist()
        result = self._check.update(outside, measurements.wheels[-1].steering_rad.tolist())
        for axis, slipped in enumerate(result.horn_slip):
            if not slipped:
                self._since_ns.pop(axis, None)
                continue
            off_rad, far = result.now_rad[axis], abs(result.difference_rad[axis]) > _FAR * self._threshold_rad
            said = (
                f"wheel {WHEELS[axis]}: its external encoder has moved {off_rad:+.3f} rad "
                f"({math.degrees(off_rad):+.1f} deg) against servo {self._names[axis]}: the horn or an "
                "encoder has slipped"
            )
            if axis not in self._since_ns:
                self._since_ns[axis] = t_ns
                events.append(Event(t_ns, "warning", "encoders", said))
            elif far and t_ns - self._since_ns[axis] > _REPORT_NS:
                stop("horn_slip", f"{said}; find zero and horn of that wheel before it drives on")
