"""Safety: judges data before they are used and setpoints before they are sent.

Stale, implausible or faulty data are reported as events; a condition under which the robot must not
go on raises `SafetyStop`, which the loop answers with `stop()` (wheels at rest, torque on). All conditions
of a cycle are judged first and named together. Deterministic: depends on the inputs seen since `reset` and
on nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hil.ring.adhesion import AdhesionWatch
from hil.ring.crosscheck import SteeringWatch
from hil.ring.doubts import WHEELS, Doubt
from hil.ring.estimate_watch import EstimateWatch
from hil.ring.fall_watch import FallWatch
from hil.ring.filter_watch import FilterWatch
from hil.ring.left_out import LeftOut
from hil.ring.motion_check import MotionCheck
from hil.ring.pace_watch import PaceWatch
from hil.ring.sample_watch import SampleWatch
from hil.ring.servo_watch import ServoWatch
from hil.ring.state_check import ObserverCheck, must_be_usable
from hil.ring.stream_watch import Healthy, StreamWatch
from hil.ring.wheel_watch import WheelWatch
from hil.vocabulary.errors import SafetyStop
from hil.vocabulary.geometry import wrap
from hil.vocabulary.signals import Event, Inputs, Measurements, Reference, RobotState, WheelSetpoint
from hil.vocabulary.suspects import suspects_of, together

_SAYS_SO = {"adhesion": "imu", "sliding": "tracker"}
"""By what a robot is found to come off or to slide: the kind that says so."""


@dataclass(frozen=True)
class SafetyLimits:
    """Limits of one bench; time-outs in s, angles in rad. `heading_limit_rad` counts on a wall only.

    `stale_s` is the time without a good sample after which a kind of device counts as silent, for those
    whose silence matters; `servo_ids` are the bus IDs in the order of `SERVOS`, for messages, empty when
    unknown.
    """

    stale_s: Mapping[str, float] = field(default_factory=lambda: {"servos": 0.1})
    wheel_rate_limit_rad_s: float = 4.9
    steering_limit_rad: float = 2.0944
    heading_limit_rad: float = math.radians(15.0)
    tracking_error_limit_m: float = 0.5
    body_speed_limit_m_s: float = 0.5
    adhesion_limit_m_s2: float = 5.0
    on_wall: bool = True
    servo_ids: tuple[int, ...] = ()


@dataclass(frozen=True)
class Checks:
    """Which sensors are held against each other, and whether the robot stops by it.

    Where the robot does not steer by what is in doubt, it is told only: a script that turns single wheels
    follows no pose, and odometry needs no camera.

    Attributes:
        motion: camera against wheels and gyro; None without.
        estimate: the estimate against motion capture; None where nobody is a witness.
        wheels: each wheel against the other three; None where they are not told to roll by one motion.
        needs_camera: whether the estimate that is followed uses the camera: the robot stops where that is
            in doubt or silent.
        steering: external encoders against the servos; None without.
        stops_by_steering: whether a pose is followed.
        estimated: devices whose measurements the estimators use.
        holders: what keeps the robot on its surface: by kind, as sentences call it.
        healthy: how often and how soon the samples of sensors should come.
        gap_s: by sensor, longest time without a good sample that is still healthy.
        brought: sensors that other packages bring, and fields of their samples that they do not measure.
        hold: what presses the robot on its surface; None where nobody measures it.
        lost_after_s: by sensor, how long it may send nothing at all before a robot that follows a pose stops;
            a sensor that can be plugged in again is waited for longer than that.
    """

    motion: MotionCheck | None = None
    estimate: EstimateWatch | None = None
    wheels: WheelWatch | None = None
    needs_camera: bool = False
    steering: SteeringWatch | None = None
    stops_by_steering: bool = False
    estimated: frozenset[str] = frozenset(("tracker", "imu"))
    hold: AdhesionWatch | None = None
    holders: Mapping[str, str] = field(default_factory=dict)
    healthy: Mapping[str, Healthy] = field(default_factory=dict)
    gap_s: Mapping[str, float] = field(default_factory=dict)
    brought: Mapping[str, Collection[str]] = field(default_factory=dict)
    lost_after_s: Mapping[str, float] = field(default_factory=dict)


class Supervisor:
    """Watches one run.

    Args:
        limits: of the bench.
        checks: of sensors against each other.

    Attributes:
        left_out: devices that are not believed any more.
        doubted: those whose word on how the robot moves was in doubt since `reset`, and whether others agreed
            against them.
    """

    def __init__(self, limits: SafetyLimits, *, checks: Checks | None = None) -> None:
        self.limits, self.checks = limits, checks if checks is not None else Checks()
        stale_s = dict(limits.stale_s)
        self._servos = ServoWatch(stale_s.pop("servos", None), limits.servo_ids)
        self._samples = SampleWatch(stale_s, self.checks.gap_s, self.checks.brought)
        self._streams = StreamWatch(self.checks.healthy)
        self.left_out = LeftOut(self.checks.estimated, on_wall=limits.on_wall)
        self.doubted: dict[str, bool] = {}
        self._widest_rad = limits.steering_limit_rad + 1e-9
        self._filter, self._pace, self._observers = FilterWatch(), PaceWatch(), ObserverCheck()
        self._fall = FallWatch(limits.adhesion_limit_m_s2, limits.body_speed_limit_m_s)
        watches = (self._filter, self.checks.estimate, self.checks.wheels)
        self._unsettling = [watch for watch in watches if watch is not None]
        self.reset()

    def reset(self) -> None:
        """Forget ages, alarms and what the sensors said."""
        self._servos.reset()
        self._samples.reset()
        self._streams.reset()
        own = self.checks
        for check in (own.motion, own.estimate, own.wheels, own.steering, own.hold):
            if check is not None:
                check.reset()
        self._fall.reset()
        self._filter.reset()
        self._observers.reset()
        self._pace.reset()
        self._causes: dict[str, str] = {}
        self._accused: set[str] = set()
        self._now_ns: int | None = None
        self.left_out.reset()
        self.doubted.clear()

    def check(self, inputs: Inputs, measurements: Measurements | None = None) -> tuple[Event, ...]:
        """Judge one cycle.

        Args:
            inputs: what the devices delivered.
            measurements: the same, aligned; without them no sensor is held against another.

        Raises:
            SafetyStop: `adhesion`, those of `hil.ring.adhesion`, `sliding`, `hardware_error`, `stale_servos`,
                `held_up`, `blocked`, `servo_jump`, `horn_slip`, `sensors_disagree`, `stale_tracker` or
                `lost_*`; the message names everything that came together. A silent IMU is an event, and so is
                a silent camera where nothing that is followed needs it; a silence that lasts is their
                driver's `DeviceTimeoutError`, which stops as well.
        """
        events = self._judge(inputs, measurements)
        if self._causes:
            raise _stop_for(self._causes, self._pace.beside(inputs.t_ns), self._accused)
        return events

    def _judge(self, inputs: Inputs, measurements: Measurements | None) -> tuple[Event, ...]:
        """Events of a cycle; `_causes` holds its conditions, the gravest first."""
        events: list[Event] = []
        self._causes, self._now_ns = {}, inputs.t_ns
        self._accused.clear()
        self._begin()
        self._fall.judge(inputs, self._blame_hold)
        if self.checks.hold is not None:
            self.checks.hold.judge(inputs, events, self._blame)
        self._pace.judge(inputs.t_ns, self._blame)
        self._servos.judge(inputs, events, self._blame)
        self._servos.check_silence(inputs, self._blame)
        self._samples.judge(inputs, events)
        self._streams.judge(inputs, events)
        self._check_camera(inputs.t_ns)
        self._check_lost(inputs.t_ns)
        if measurements is not None:
            self._compare(inputs, measurements, events)
        return tuple(events)

    def _begin(self) -> None:
        """Whatever was found about the estimate before makes it unsure from now on."""
        most_m = most_rad = 0.0
        for watch in self._unsettling:
            off_m, off_rad = watch.take_off()
            most_m = off_m if off_m > most_m else most_m
            most_rad = off_rad if off_rad > most_rad else most_rad
        self.left_out.begin((most_m, most_rad))

    def _check_camera(self, t_ns: int) -> None:
        """Who is driven past a blind camera goes by odometry alone, which slips unseen."""
        if not self.checks.needs_camera or "tracker" in self.left_out:
            return
        if silence := self._samples.silence("tracker", t_ns):
            self._blame(
                "stale_tracker",
                f"no usable pose of the camera {silence}, which the estimate that is followed needs: check "
                "its lens, light and cable, or follow odometry",
            )

    def _check_lost(self, t_ns: int) -> None:
        """Who is driven does not wait for a sensor that is to come back."""
        for name, limit_s in self.checks.lost_after_s.items():
            away_s = self._samples.away_s(name, t_ns)
            if away_s > limit_s:
                remedy = "check its cable and power, then start the motion again"
                self._blame(f"lost_{name}", f"nothing from {name} for {away_s:.1f} s: {remedy}")

    def _blame(self, reason: str, message: str) -> None:
        known = self._causes.get(reason)
        self._causes[reason] = message if known is None else f"{known}; {message}"

    def _blame_hold(self, reason: str, message: str) -> None:
        """The robot has come off or slides: whatever holds it may be the cause."""
        self._blame(reason, message + self._look_at_holders("look"))
        self._accused.update((*self._held_by, _SAYS_SO[reason]))

    def _look_at_holders(self, begin: str) -> str:
        """The advice to look at what holds the robot; empty where nothing does that is known of."""
        holders = " and the ".join(self._held_by.values())
        return f"; {begin} at the {holders}" if holders else ""

    @property
    def _held_by(self) -> Mapping[str, str]:
        """What lets a robot slide that gives too little: by kind; nothing where none can."""
        return self.checks.holders if self.limits.on_wall else {}

    def _may_slide(self, event: Event) -> Event:
        """The same of wheels that tell more or less than others: they may slip, because the robot slides."""
        if event.source != WHEELS.name or not self._held_by:
            return event
        told = event.message + self._look_at_holders("if it slides, look")
        return replace(event, source=together((event.source, *self._held_by)), message=told)

    def _compare(self, inputs: Inputs, measurements: Measurements, events: list[Event]) -> None:
        """Hold sensors against each other."""
        checks = self.checks
        if checks.wheels is not None:
            checks.wheels.judge(inputs.t_ns, measurements.wheels, events)
        if checks.steering is not None:
            stop = self._blame if checks.stops_by_steering else _ignore
            checks.steering.judge(inputs, measurements, events, stop)
        if checks.motion is not None:
            for doubt in checks.motion.update(measurements):
                self._note(doubt)
                if checks.wheels is not None and doubt.may_slide:
                    checks.wheels.doubt()
                if not doubt.grave:
                    if doubt.unseen and checks.needs_camera:
                        self.left_out.shake(doubt)
                    events.append(self._told(doubt, inputs.t_ns))
                elif checks.stops_by_steering and self.left_out.can_do_without(doubt):
                    checks.motion.leave_out(doubt.source)
                    events.append(self.left_out.take(doubt, inputs.t_ns))
                elif checks.needs_camera:
                    standing = self._servos.standing(inputs.t_ns)
                    if standing and "blocked" not in self._causes:
                        self._blame("blocked", standing)
                    told = self._told(doubt, inputs.t_ns)
                    self._blame("sensors_disagree", told.message)
                    self._accused.update(told.suspects)

    def _told(self, doubt: Doubt, t_ns: int) -> Event:
        """What is said of a doubt, and of whom: of two of whom nobody knows which is wrong, of both."""
        names, told = [doubt.source, *([] if doubt.confirmed else [doubt.against])], doubt.message
        if doubt.may_slide:
            names += self._held_by
            told += self._look_at_holders("if it slides, look")
        return Event(t_ns, "warning", together(names), told)

    def _note(self, doubt: Doubt) -> None:
        """Whose word is in doubt: both of two, until others agree against one of them."""
        if doubt.confirmed:
            self.doubted = {name: sure for name, sure in self.doubted.items() if sure}
            self.doubted[doubt.source] = True
        else:
            for name in (doubt.source, doubt.against):
                self.doubted.setdefault(name, False)

    def guard(self, state: RobotState, reference: Reference | None) -> tuple[Event, ...]:
        """Judge the estimate.

        Raises:
            SafetyStop: `not_finite`, `negative_variance`, `stale_estimate`, `heading`, `tracking`, or
                `sensors_disagree` with motion capture.
        """
        events: list[Event] = []
        must_be_usable(state, self._now_ns)
        self._filter.judge(state, events)
        found: dict[str, str] = {}
        accused: set[str] = set()
        x_m, y_m, heading_rad = state.pose_body_in_wall.tolist()
        if self.checks.hold is not None:
            self.checks.hold.heading_rad = heading_rad
        steepest = self.limits.heading_limit_rad
        upright = not self.limits.on_wall or -steepest <= heading_rad <= steepest
        if not upright and abs(wrap(heading_rad)) > steepest:
            found["heading"] = (
                f"heading {math.degrees(heading_rad):.1f} deg exceeds "
                f"{math.degrees(steepest):.1f} deg: the robot would lose its hold"
            )
        if reference is not None:
            wanted_x_m, wanted_y_m, wanted_rad = reference.pose_in_wall.tolist()
            if not math.isfinite(wanted_x_m + wanted_y_m + wanted_rad):
                raise SafetyStop("not_finite", "the reference is not finite")
            error_m = math.hypot(wanted_x_m - x_m, wanted_y_m - y_m)
            if error_m > self.limits.tracking_error_limit_m:
                found["tracking"] = f"{error_m:.3f} m from the reference"
        watch = self.checks.estimate
        if watch is not None and watch.witness not in self.left_out:
            watch.judge(state, events, found.__setitem__)
            if "sensors_disagree" in found:
                found["sensors_disagree"] += self._look_at_holders("if it slides, look")
                accused.update((*watch.accused, *self._held_by))
        if found:
            raise _stop_for(found, self._pace.beside(state.t_ns), accused)
        return tuple(map(self._may_slide, events))

    def notice(self, observer: str, state: RobotState, now_ns: int) -> tuple[Event, ...]:
        """Judge an estimate that is not followed: it stops nothing, but is no longer silent.

        Args:
            observer: its name.
            state: what it estimates.
            now_ns: time of the cycle.
        """
        return self._observers.judge(observer, state, now_ns)

    @property
    def agreed(self) -> frozenset[str]:
        """Devices that have told of a way since `reset` as others did."""
        return frozenset() if self.checks.motion is None else self.checks.motion.agreed

    def figures(self) -> Mapping[str, float]:
        """What the checks of this cycle measured, for the robot's state."""
        return {} if self.checks.hold is None else self.checks.hold.figures

    def limit(self, setpoint: WheelSetpoint) -> WheelSetpoint:
        """Setpoint within command limits; scaling keeps the centre of rotation.

        Raises:
            SafetyStop: `not_finite` or `steering_limit`.
        """
        rates: list[float] = setpoint.wheel_rate_rad_s.tolist()
        angles: list[float] = setpoint.steering_rad.tolist()
        if not math.isfinite(sum(rates) + sum(angles)):
            raise SafetyStop("not_finite", "a setpoint is not finite")
        if max(angles) > self._widest_rad or min(angles) < -self._widest_rad:
            told_deg = np.degrees(angles).round(1).tolist()
            raise SafetyStop("steering_limit", f"steering setpoint {told_deg} deg")
        fastest = self.limits.wheel_rate_limit_rad_s
        if max(rates) > fastest or min(rates) < -fastest:
            slowed = setpoint.wheel_rate_rad_s * (fastest / max(map(abs, rates)))
            setpoint, rates = WheelSetpoint(slowed, setpoint.steering_rad), slowed.tolist()
        self._servos.asked_rad_s = rates
        return setpoint


def _ignore(reason: str, message: str) -> None:
    """What is told as an event is enough."""


def _stop_for(causes: dict[str, str], beside: str, accused: Iterable[str]) -> SafetyStop:
    """One stop for all conditions that came together; its reason is the first, `beside` ends it.

    `accused`: whom they name beside those whom their reasons do.
    """
    (reason, message), *others = causes.items()
    suspects = {*accused, *(name for also, _ in others for name in suspects_of(also))}
    told = "; ".join([message, *(f"also {k}: {v}" for k, v in others)]) + beside
    return SafetyStop(reason, told, sorted(suspects))
