"""Checks that the fan's force is measured and holds the robot: one condition of HELD.

The force that counts is the one on which two measurements agree, else the smallest; without a second sensor
that confirms it, more is asked for (`hil.robot.believed_force.UNCONFIRMED`).

A robot whose fan has just failed is still at rest. A controller without reports may have stopped its motor,
or will do so at its timeout, and the fan takes a second to run down. So a silent fan is not trusted until
the load cells have measured enough force for longer than that, and a falling force counts as NOT HELD before
it is too small. Propellers carry a part of the weight: their reported push counts. Propellers without reports
may not have understood the command: they count once the robot has been at rest for as long as they would need
to let it slide (`hil.bench.hold.propeller_handover`). Load cells do not measure their push.
"""

import logging
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from hil.bench.hold.propeller_handover import PropellerObservation, least_push_n
from hil.bench.loop_settings import adhesion_limits, can_fall, pretended_holders, thrust_wanted_n
from hil.config.adhesion import AdhesionConfig
from hil.config.bench import BenchConfig
from hil.config.can_motor import DaemonMotorConfig
from hil.config.thrust import ThrustConfig
from hil.core.clock import nanoseconds
from hil.core.errors import HilError
from hil.core.registry import kinds
from hil.core.signals import LoadCellSample, Status, worst
from hil.loop.checks.adhesion_limits import AdhesionLimits, FanForces, SlidePush
from hil.loop.checks.force_trend import ForceTrend
from hil.loop.device_set import DeviceSet
from hil.robot.believed_force import CELLS, UNCONFIRMED, Believed
from hil.robot.motor_cross_checks import POWER, SPEED, VOLTAGE

LOG = logging.getLogger(__name__)
RUN_DOWN_S = 1.0
"""Time after which a fan without current has lost more force than any reserve."""
_AHEAD_S = 6.0
"""A falling force holds the robot only if it will be sufficient for this time."""
MEASURES = ("adhesion", "load_cells")
"""Kinds whose samples give a force."""
_CELLS_KEYS = ("load_cells.n_per_count", "load_cells.zero_n")


class MeasuredForces:
    """Forces by the samples of fan and load cells.

    Args:
        limits: adhesion limits of the bench.

    Attributes:
        fan: reports of the fan's controller.
    """

    def __init__(self, limits: AdhesionLimits) -> None:
        self._limits, self.fan = limits, FanForces(limits.fan)

    def take(self, samples: Iterable[Any]) -> Iterator[tuple[str, int, float]]:
        """(measurement, time in ns, force in N) of each usable sample of the kinds in `MEASURES`."""
        for sample in samples:
            if isinstance(sample, LoadCellSample):
                if self._limits.zero_n is None:
                    continue
                force_n = self._limits.cells_n(sample)
                if worst(sample) is Status.OK and math.isfinite(force_n):
                    yield CELLS, sample.stamp.t_ns, force_n
            elif self._limits.has_fan and self.fan.take(sample):
                for name, force_n in self.fan.forces_n.items():
                    yield name, sample.stamp.t_ns, force_n


def read_whatever_happens(devices: DeviceSet, name: str) -> Sequence[Any]:
    """Samples of a device since the last read; none without the device, or if its driver raises."""
    device = devices.get(name)
    try:
        samples: Sequence[Any] = () if device is None else device.read()
    except HilError:
        return ()
    except Exception:  # the check goes on with the others
        LOG.warning("%s: its driver failed while the hold was checked", name, exc_info=True)
        return ()
    return samples


def in_words(forces: Mapping[str, float], believed: Believed) -> str:
    """Text with the forces by speed and cells, the one that counts, and those that contradict it."""
    told = {name: n for name, n in forces.items() if name in (SPEED, CELLS, believed.by)}
    told.update(believed.against)
    return ", ".join(f"{force_n:.1f} N by {name}" for name, force_n in told.items())


class AdhesionForceCheck:
    """Monitors fan and load cells of a robot that has been stopped on a wall.

    Args:
        devices: devices of the bench.
        limits: required forces; None where no device reports a force, or the robot cannot fall.
        fan: the fan's settings, if its controller stops the motor at a timeout.
        alone: check of propellers that report nothing.
        carried: True if such propellers carry a robot that can fall.
        pretended: fan and propellers that are emulated beside real servos: they hold no real robot.
        push_keys: keys of the bench file that scale the propellers' push.
        blind: devices that are in another world than the servos: they do not measure this robot.
        heading_rad: heading of the body at the start.

    Attributes:
        heading_rad: last estimated heading of the body; that of the start pose before the first estimate.
        waits: True if only the check of propellers without commands is unfinished.
        lacks: True if the measured force is too small, or falls.
    """

    def __init__(
        self,
        devices: DeviceSet,
        limits: AdhesionLimits | None,
        fan: DaemonMotorConfig | None,
        alone: PropellerObservation,
        carried: bool = False,
        pretended: Sequence[str] = (),
        push_keys: Sequence[str] = (),
        blind: Sequence[str] = (),
        heading_rad: float = 0.0,
    ) -> None:
        self._devices, self._limits, self._pretended = devices, limits, tuple(pretended)
        self._measures = tuple(name for name in MEASURES if name not in blind)
        self._outlasts_ns = nanoseconds(RUN_DOWN_S + (0.0 if fan is None else fan.timeout_s))
        self._stale_ns = 0 if limits is None else nanoseconds(limits.stale_s)
        self._forces: dict[str, tuple[int, float]] = {}
        self._trends: dict[str, ForceTrend] = {}
        self._push: tuple[int, float] | None = None
        self._enough_since_ns: int | None = None
        self._alone, self._carried = alone, carried
        self._push_keys = tuple(push_keys)
        self._push_trouble = ""
        self._measured = None if limits is None else MeasuredForces(limits)
        self.heading_rad = heading_rad
        self.waits = self.lacks = False

    def begin(self, *, for_good: bool = False) -> None:
        """Begin a check and discard earlier samples; `for_good`: the last check before the bench closes."""
        self._forces.clear()
        self._trends.clear()
        self._push = None
        self._enough_since_ns = None
        self._alone.begin(for_good=for_good)

    def end(self) -> None:
        """End the check and resume sending commands to the propellers."""
        self._alone.end()
        self.waits = False

    def doubt(self, now_ns: int, *, sees_slide: bool, moves: bool = False) -> str:
        """Why the robot may not stay pressed on its wall; empty for no reason.

        Args:
            now_ns: present time.
            sees_slide: True if a trusted position sensor shows the robot at rest.
            moves: True if a sensor shows motion.
        """
        self.waits = self.lacks = False
        if self._limits is None or self._measured is None:
            return self._nothing_real() or self._unmeasured(now_ns, sees_slide, moves)
        for name in self._measures:
            for sensor, t_ns, force_n in self._measured.take(self._samples(name)):
                self._forces[sensor] = t_ns, force_n
                self._trends.setdefault(sensor, ForceTrend()).follow(t_ns, force_n)
        fresh = self._fresh(now_ns)
        believed = self._limits.believed(fresh)
        push_n, without = self._counted_push(now_ns, sees_slide, moves, believed.force_n)
        least_n = self._least_n(push_n, believed)
        message = in_words(fresh, believed)
        if not believed.force_n >= least_n:  # NaN is not enough either
            message = message or "no sensor measures it"
            whole_n = self._least_n(self._limits.nominal_thrust_n, believed)
            self.waits = self._alone.begun and believed.force_n >= whole_n
            self.lacks = believed.force_n < whole_n
            if self.waits:
                self._outlasted(now_ns, fresh)
            else:
                self._enough_since_ns = None
            needed = f"{least_n:.1f} N are needed{self._unconfirmed(believed)}{without}"
            return f"what presses the robot on the wall: {message}; {needed}: secure the robot"
        for name in {*fresh} - {*believed.against, POWER}:
            falling_n_s = -self._trends[name].slope_n_s()
            if not fresh[name] - _AHEAD_S * falling_n_s >= least_n:
                self.lacks = True
                return (
                    f"the force by {name} falls by {falling_n_s:.0f} N/s; {message} so far: secure the robot"
                )
        if not self._outlasted(now_ns, fresh):
            return f"the fan's controller is silent, it may have let go; {message} so far: secure the robot"
        return ""

    def _least_n(self, push_n: float, believed: Believed) -> float:
        """Force that is needed with a push of the propellers; more where nothing confirms the force."""
        assert self._limits is not None
        needed_n = self._limits.statics.needed_n(push_n, self.heading_rad)
        return needed_n if believed.confirmed else UNCONFIRMED * needed_n

    def _unconfirmed(self, believed: Believed) -> str:
        if believed.confirmed or not believed.by:
            return ""
        return f" ({UNCONFIRMED:g} times what the robot needs, as no second sensor confirms the force)"

    def _outlasted(self, now_ns: int, fresh: Mapping[str, float]) -> bool:
        """Whether the fan reports, or has pressed without reports for longer than its run-down time."""
        if not (self._limits and self._limits.has_fan) or SPEED in fresh or VOLTAGE in fresh:
            self._enough_since_ns = None
            return True
        if self._enough_since_ns is None:
            self._enough_since_ns = now_ns
        return now_ns - self._enough_since_ns >= self._outlasts_ns

    def _nothing_real(self) -> str:
        """Message if fan or propellers are emulated and no sensor measures the force; else empty."""
        if not self._pretended:
            return ""
        return (
            "torque is on, but nothing real reports what presses the robot on the wall "
            f"({', '.join(kinds()[name].noun for name in self._pretended)}: emulated beside real servos): do "
            "not emulate what holds a real robot; secure the robot"
        )

    def _unmeasured(self, now_ns: int, sees_slide: bool, moves: bool) -> str:
        """Message if unmonitored propellers carry the robot and no sensor measures the force; else empty."""
        if not self._carried:
            return ""
        left_s = self._alone.left_s(now_ns, rests=sees_slide, moves=moves, least_n=0.0)
        self.waits = self._alone.begun
        if not left_s:
            return ""
        seen = _to_be_seen(left_s)
        return f"what carries the robot is not measured: the propellers report nothing, and {seen}"

    def _counted_push(self, now_ns: int, sees_slide: bool, moves: bool, force_n: float) -> tuple[float, str]:
        """Confirmed push of the propellers (N), and why it is less than commanded, as a text."""
        limits = self._limits
        assert limits is not None
        if not limits.nominal_thrust_n:
            return 0.0, ""
        if "thrust" in self._pretended:
            return 0.0, " without the propellers: they are emulated beside real servos"
        if not limits.reports_thrust:
            return self._unheard_push(now_ns, sees_slide, moves, force_n)
        for sample in self._samples("thrust"):
            push_n = limits.push_n(sample)
            self._push_trouble = sample.trouble
            if math.isfinite(push_n):
                self._push = sample.stamp.t_ns, push_n
        if self._push is None or now_ns - self._push[0] > self._stale_ns:
            return 0.0, " without the propellers: their controllers are silent and may have let go"
        if limits.pushes_too_much(self._push[1]):
            return 0.0, (
                f" without the propellers: they report {self._push[1]:.1f} N, more than the "
                f"{limits.nominal_thrust_n:.1f} N that they are to give, so that what they give is not known"
            )
        if self._push_trouble:
            return 0.0, f" without the propellers, whose reports contradict each other: {self._push_trouble}"
        return self._push[1], f" with the {self._push[1]:.1f} N that the propellers report"

    def _unheard_push(self, now_ns: int, sees_slide: bool, moves: bool, force_n: float) -> tuple[float, str]:
        """Push of propellers without reports, as of `_counted_push`; (0, "") where the fan alone suffices."""
        limits = self._limits
        assert limits is not None
        statics, heading_rad, asked_n = limits.statics, self.heading_rad, limits.nominal_thrust_n
        if force_n >= UNCONFIRMED * statics.needed_n(0.0, heading_rad):
            return 0.0, ""
        measured = math.isfinite(force_n)
        least_n = least_push_n(statics, force_n if measured else 0.0, asked_n, heading_rad)
        rests = sees_slide and measured
        left_s = self._alone.left_s(now_ns, rests=rests, moves=moves, least_n=least_n)
        if not left_s:
            return asked_n, ""
        return 0.0, f" without the propellers: they report nothing, and {_to_be_seen(left_s)}"

    def push_against(self, along_m: float) -> SlidePush | None:
        """Set-point of the propellers against a slide (m along body x); None where it stays as it is."""
        if self._limits is None:
            return None
        force_n = min((n for _, n in self._forces.values()), default=math.nan)
        return self._limits.push_against(along_m, force_n, self.heading_rad)

    def feels(self, now_ns: int) -> bool:
        """Whether the load cells have measured the force recently; it is sufficient if `doubt` is empty."""
        return CELLS in self._fresh(now_ns)

    def basis(self, now_ns: int) -> tuple[str, bool, tuple[str, ...]]:
        """What HELD rests on: measurement of the force, whether another confirms it, keys that scale it.

        The name is empty, and there are no keys, where no sensor measures the force.
        """
        if self._limits is None:
            return "", False, ()
        believed = self._limits.believed(self._fresh(now_ns))
        keys: tuple[str, ...] = ()
        if believed.by == CELLS:
            keys = _CELLS_KEYS
        elif self._limits.fan is not None and believed.by:
            fan = self._limits.fan
            keys = fan.keys if believed.by == SPEED else (f"{fan.table}.rpm_per_v", *fan.keys[-2:])
        pushed = self._push_keys if keys and self._limits.nominal_thrust_n else ()
        return believed.by.removeprefix("the "), believed.confirmed, (*keys, *pushed)

    def in_words(self, now_ns: int) -> str:
        """Text with the adhesion force by each sensor, and the silent sensors; empty without a sensor."""
        if self._limits is None:
            return ""
        fresh = self._fresh(now_ns)
        believed = self._limits.believed(fresh)
        measures = {SPEED: self._limits.has_fan, CELLS: self._limits.zero_n is not None}
        reported = [in_words(fresh, believed)] * bool(fresh)
        reported += [f"nothing by {name}" for name, there in measures.items() if there and name not in fresh]
        if believed.against:
            reported.append(f"{believed.by} counts, the other contradicts it")
        for text in (self._measured.fan.contradiction if self._measured else "", self._push_trouble):
            reported += [text] * bool(text)
        if self._limits.nominal_thrust_n and not self._limits.reports_thrust:
            reported.append("the propellers' push has no sensor")
        if believed.by and not believed.confirmed:
            reported.append("no second sensor confirms the force")
        return f"; pressed on the wall: {', '.join(reported)}"

    def _fresh(self, now_ns: int) -> dict[str, float]:
        """Forces (N) measured recently, by sensor."""
        return {name: n for name, (t_ns, n) in self._forces.items() if now_ns - t_ns <= self._stale_ns}

    def _samples(self, name: str) -> Sequence[Any]:
        return read_whatever_happens(self._devices, name)


def _to_be_seen(left_s: float) -> str:
    """Text with the remaining observation time before propellers without reports count."""
    if math.isfinite(left_s):
        return f"the robot is to be seen at rest for {left_s:.1f} s more"
    return "no sensor sees whether it slides, or knows how long they would need to let it"


def press_watch(config: BenchConfig, devices: DeviceSet) -> AdhesionForceCheck:
    """Make the check for a bench whose robot hangs on a wall without a tether.

    Devices in another world than the servos are left out: they do not press this robot.
    """
    pretended, blind = pretended_holders(config), config.elsewhere()
    config = config.of_one_world()
    fan = config.of(AdhesionConfig)
    kept = fan if isinstance(fan, DaemonMotorConfig) else None
    limits = adhesion_limits(config) if can_fall(config) else None
    own, asked_n = config.of(ThrustConfig), thrust_wanted_n(config)
    carried = can_fall(config) and asked_n > 0.0 and "thrust" in config.devices()
    carried = carried and not isinstance(own, DaemonMotorConfig)
    push_keys = () if own is None else own.push_keys
    alone = PropellerObservation(devices, own, asked_n)
    start_rad = config.environment.start_pose[2]
    return AdhesionForceCheck(devices, limits, kept, alone, carried, pretended, push_keys, blind, start_rad)
