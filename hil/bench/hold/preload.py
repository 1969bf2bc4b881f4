"""Presses the robot on its wall before anything moves: fan and propellers on, force measured, then servos."""

import math
from typing import Any

from hil.bench.hold.adhesion_force import MEASURES, MeasuredForces, in_words
from hil.bench.hold.force_schedule import LARGEST_STEP_DOWN_N
from hil.bench.loop_settings import adhesion_limits, force_wanted_n, hold_keys, thrust_wanted_n
from hil.config.adhesion import AdhesionConfig
from hil.config.bench import BenchConfig
from hil.config.can_motor import DaemonMotorConfig
from hil.config.thrust import ThrustConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError, SafetyStop
from hil.core.registry import kinds
from hil.core.signals import Status
from hil.loop.checks.adhesion_limits import AdhesionLimits
from hil.loop.device_set import DeviceSet
from hil.robot.believed_force import CELLS, Believed
from hil.robot.motor_cross_checks import SPEED, VOLTAGE

_STEP_NS = nanoseconds(0.01)
_PATIENCE_NS = nanoseconds(12.0)
_STEADY_NS = nanoseconds(0.1)
_TETHERED_SHARE = 0.9
_PUSHES = 0.9
"""Share of the set-point from which propellers count as running."""
_NO_SAMPLE_NS = nanoseconds(1.0)
"""Time for which a reading counts, and for which a first one is waited for."""


class Preload:
    """Presses the robot on its wall by fan and propellers.

    Args:
        config: the bench configuration.
        devices: devices of the bench, open.
        clock: the bench clock.
    """

    def __init__(self, config: BenchConfig, devices: DeviceSet, clock: Clock) -> None:
        self._config, self._devices, self._clock = config, devices, clock
        self._limits = adhesion_limits(config)
        self._seen: dict[str, tuple[int, float]] = {}
        self._seen_n: dict[str, float] = {}
        self._measured = None if self._limits is None else MeasuredForces(self._limits)
        self._push_trouble = ""
        propellers = config.of(ThrustConfig)
        self._propellers = propellers if isinstance(propellers, DaemonMotorConfig) else None
        self._push_n = 0.0

    def hold(self) -> str:
        """Set the working forces, and wait until the measured force is sufficient.

        Does nothing if the bench has no device that holds the robot, or the robot is on the floor.

        Returns:
            The measured forces as a text; empty if nothing was done.

        Raises:
            SafetyStop: `adhesion`: the force stays below the limit of this surface; `adhesion_disagree`: its
                sensors contradict each other. Nothing has moved, and the fan keeps running.
            DeviceError: a device fails.
        """
        limits = self._limits
        if not self._config.environment.on_wall:
            return ""
        thrust_n = thrust_wanted_n(self._config)
        self._ask("thrust", thrust_n)
        if limits is None:
            return ""
        raised_n = self._raised_n(limits)
        self._compare("nothing has been changed", settled=False)
        fan = self._config.of(AdhesionConfig)
        if fan is None or raised_n <= fan.highest_force_n:  # a fan that runs at more goes on so
            self._ask("adhesion", raised_n or force_wanted_n(self._config))
        limit_n = self._wait(limits, thrust_n)
        self._compare("nothing has moved")
        message = (
            f"Pressed on the wall with {self._forces_text()}; {limit_n:.1f} N are the least on this surface."
        )
        if raised_n:
            message += (
                f" The fan ran at {raised_n:.1f} N, more than the {force_wanted_n(self._config):g} N of the "
                "bench's file, as after a stop that raises it, and stays there: less might let the robot "
                "slide where it stands. Once it is secured, `hil adhesion on --tethered` lowers it."
            )
        blind = [kinds()[name].noun for name in self._config.elsewhere() if name in MEASURES]
        if blind:
            message += " In another world than the servos, with no word on what presses this robot: "
            message += ", ".join(blind) + "."
        return message

    def _raised_n(self, limits: AdhesionLimits) -> float:
        """Present force of a fan that runs above its set-point (N), else 0.

        A stop or an operator has raised it at the robot's present place; both take precedence.
        """
        fan, wanted_n = self._config.of(AdhesionConfig), force_wanted_n(self._config)
        if fan is None or not limits.has_fan:
            return 0.0
        end_ns = self._clock.now_ns() + _NO_SAMPLE_NS
        while SPEED not in self._seen_n and self._clock.now_ns() < end_ns:
            self._look()
            self._clock.sleep_until_ns(self._clock.now_ns() + _STEP_NS)
        runs_n = self._seen_n.get(SPEED, 0.0)
        return runs_n if runs_n > wanted_n + LARGEST_STEP_DOWN_N else 0.0

    def _ask(self, name: str, force_n: float) -> None:
        """Send a force set-point; retry while a daemon has no report of its motor yet."""
        device = self._devices.get(name)
        if device is None:
            return
        end_ns = self._clock.now_ns() + _NO_SAMPLE_NS
        while True:
            self._look()
            try:
                device.set_force_n(force_n)
                return
            except DeviceError:
                if self._clock.now_ns() >= end_ns:
                    raise
            self._clock.sleep_until_ns(self._clock.now_ns() + _STEP_NS)

    def _compare(self, state: str, *, settled: bool = True) -> None:
        """Raise `SafetyStop` if measurements of the force contradict each other, and may let the robot fall.

        Args:
            state: state of the robot so far, in words.
            settled: True if fan and cells have had time to agree: a tether may press, too.
        """
        assert self._measured is not None
        believed, fan = self._believed(), self._measured.fan
        why = fan.impossible or ("" if believed.confirmed else fan.contradiction)
        split = settled and bool({CELLS, SPEED} & {*believed.against})
        if why or split:
            why = f"; {why}" * bool(why)
            raise SafetyStop(
                "adhesion_disagree",
                f"{state}, and the measurements of the force disagree: {self._forces_text()}{why}; look at "
                "load_cells.zero_n, adhesion.pole_pairs, rated_force_n and the seal, and run adhesion_check",
            )

    def _believed(self) -> Believed:
        return Believed(math.nan) if self._limits is None else self._limits.believed(self._seen_n)

    def _forces_text(self) -> str:
        return in_words(self._seen_n, self._believed())

    def _wait(self, limits: AdhesionLimits, thrust_n: float) -> float:
        """Wait for a sufficient force; return its limit, N. Raises `SafetyStop` at the timeout."""
        limit_n = limits.limit_n(thrust_n, self._config.environment.start_pose[2])
        if self._config.safety.tethered:
            limit_n = min(limit_n, _TETHERED_SHARE * force_wanted_n(self._config))
        steady_ns: int | None = None
        end_ns = self._clock.now_ns() + _PATIENCE_NS
        while (now_ns := self._clock.now_ns()) < end_ns:
            force_n = self._look()
            if force_n < limit_n or not math.isfinite(force_n) or not self._pushes(limits, thrust_n):
                steady_ns = None
            elif steady_ns is None:
                steady_ns = now_ns
            steady = steady_ns is not None and now_ns - steady_ns >= _STEADY_NS
            if steady or (steady_ns is not None and force_n >= self._enough(limit_n)):
                return limit_n
            self._clock.sleep_until_ns(now_ns + _STEP_NS)
        text = self._forces_text() or "nothing measured"
        if not self._pushes(limits, thrust_n):
            text += f", and pushed up with {self._push_n:.1f} N of {thrust_n:.1f}"
            if limits.pushes_too_much(self._push_n):
                text += " by their speed: a lost blade, a loose propeller, or a miscounted speed"
            text += f": {self._push_trouble}" * bool(self._push_trouble)
        raise SafetyStop(
            "adhesion",
            f"the robot is not pressed on the wall: {text}; {limit_n:.1f} N are the least on this surface. "
            "Nothing has moved; look at fan, battery, seal and load cells (`hil doctor`), and at what scales "
            f"these figures: {', '.join(hold_keys(self._config))}",
        )

    def _enough(self, limit_n: float) -> float:
        """Force near the set-point, N; from there on one sample is enough."""
        return max(limit_n, 0.9 * force_wanted_n(self._config))

    def _look(self) -> float:
        """Newest force, the smallest of all sensors, N; NaN before every sensor has reported."""
        limits = self._limits
        if limits is None:
            return math.nan
        assert self._measured is not None
        for name in MEASURES:
            newest = {n: (t_ns, force_n) for n, t_ns, force_n in self._measured.take(self._samples(name))}
            if SPEED in newest or VOLTAGE in newest:
                self._seen = {n: seen for n, seen in self._seen.items() if n == CELLS}
            self._seen.update(newest)
        old_ns = self._clock.now_ns() - _NO_SAMPLE_NS
        self._seen_n = {n: force_n for n, (t_ns, force_n) in self._seen.items() if t_ns > old_ns}
        heard = bool(self._seen_n.keys() - {CELLS})
        complete = heard >= limits.has_fan and (CELLS in self._seen_n) >= (limits.zero_n is not None)
        return self._believed().force_n if complete else math.nan

    def _pushes(self, limits: AdhesionLimits, thrust_n: float) -> bool:
        """Whether the push of propellers that report their speed is near its set-point."""
        if self._propellers is None:
            return True
        for sample in self._samples("thrust"):
            self._push_trouble = sample.trouble
            if sample.status is Status.OK:
                self._push_n = self._propellers.force_at_n(sample.throttle)
        if self._push_trouble:
            return False
        return self._push_n >= _PUSHES * thrust_n and not limits.pushes_too_much(self._push_n)

    def _samples(self, name: str) -> Any:
        device = self._devices.get(name)
        return () if device is None else device.read()
